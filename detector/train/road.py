"""The road of a fixed camera without vehicles, and boxes of a teacher that show nothing else.

A burnt-in logo, a painted letter, a barrier stay where they are from picture to picture, and a teacher
takes some of them for vehicles each time. A box whose edges are those of the camera's empty road (the
median of its pictures in one light) is taken out, so that the place is taught as road; where the likeness
is between, the box is ignored. Of the labels of sg_lta 1.2 % are alike by more than `SAME`, of the boxes that
`verge detect` finds there without a label 33 %. With few pictures the median keeps what stood long: of
camera 1505 by day (17 pictures) 6 of 20 labels.
"""

import cv2
import numpy as np

import data
from evidence_frames import field, likeness

FEWEST = 8  # pictures of a camera in one light from which its empty road is known
ALIKE = 0.55  # correlation with the empty road below which the camera looked elsewhere
MOSTLY = 0.9  # of its pictures must be that much alike, else the camera moves
SAME, LIKE = 0.6, 0.45  # likeness from which a box shows the road, and from which it is in doubt
MARGIN = 2  # px around a box that are compared with it


def cameras(pictures):
    """Pictures of one fixed camera in one light that look the same way: they, their pixels, and its empty
    road (BGR). A video whose camera moves is none."""
    groups = {}
    for p in pictures:
        if p.dataset != "street":
            groups.setdefault(name(p), []).append(p)
    for members in groups.values():
        # Scenes of atl_v2 join cameras that look alike.
        if len(members) < FEWEST or len({(p.width, p.true_height) for p in members}) > 1:
            continue
        images = [p.read() for p in members]
        empty = np.median(images, 0).astype(np.uint8)
        still = [np.corrcoef(blurred(img), blurred(empty))[0, 1] >= ALIKE for img in images]
        if np.mean(still) >= MOSTLY:
            yield ([p for p, s in zip(members, still) if s], [i for i, s in zip(images, still) if s], empty)


def name(picture):
    """Of the camera in one light."""
    return picture.dataset, picture.group, picture.night


def blurred(img):
    return cv2.GaussianBlur(cv2.cvtColor(img, cv2.COLOR_BGR2GRAY), (0, 0), 2).ravel()


def edges(img):
    return field(cv2.GaussianBlur(cv2.cvtColor(img, cv2.COLOR_BGR2GRAY), (0, 0), 0.8).astype(np.float32))


def settle(pictures, found):
    """Takes the road out of `found` ({path: rows x0 y0 x1 y1 score}); returns how many boxes went."""
    gone = 0
    for members, images, road in cameras(pictures):
        empty = edges(road)
        for p, img in zip(members, images):
            rows = found.get(p.path, np.zeros((0, 5), np.float32))
            if len(rows) == 0:
                continue
            grown = np.clip(rows[:, :4] + [-MARGIN, -MARGIN, MARGIN, MARGIN], 0, None)
            alike = likeness(edges(img), empty, grown, 1.0)
            doubt = alike >= LIKE
            rows[doubt, 4] = np.minimum(rows[doubt, 4], (data.DOUBT + data.SURE) / 2)
            found[p.path] = rows[alike < SAME]
            gone += int((alike >= SAME).sum())
    return gone
