"""The road of a fixed camera without vehicles, and boxes of a teacher that show nothing else.

A burnt-in logo, a painted letter, a barrier stay where they are from picture to picture, and a teacher
takes some of them for vehicles each time. A box whose edges are those of the camera's empty road (the
median of its pictures in one light) is taken out, so that the place is taught as road; where the likeness
is between, the box is ignored. Of the data set's own labels on sg_lta and topview 0.9 % are alike by more
than `SAME`, of the COCO-taught net's boxes without a label 21 %.
"""

import cv2
import numpy as np

import data
from evidence_frames import field, likeness

FEWEST = 8  # pictures of a camera in one light from which its empty road is known
SAME, LIKE = 0.6, 0.45  # likeness from which a box shows the road, and from which it is in doubt
MARGIN = 2  # px around a box that are compared with it


def views(pictures):
    """Pictures of one fixed camera in one light: lists of `Picture`."""
    groups = {}
    for p in pictures:
        if p.dataset != "street":
            groups.setdefault((p.dataset, p.group, p.night), []).append(p)
    for members in groups.values():
        # Scenes of atl_v2 join cameras that look alike.
        if len(members) >= FEWEST and len({(p.width, p.true_height) for p in members}) == 1:
            yield members


def edges(img):
    return field(cv2.GaussianBlur(cv2.cvtColor(img, cv2.COLOR_BGR2GRAY), (0, 0), 0.8).astype(np.float32))


def settle(pictures, found):
    """Takes the road out of `found` ({path: rows x0 y0 x1 y1 score}); returns how many boxes went."""
    gone = 0
    for members in views(pictures):
        images = [p.read() for p in members]
        empty = edges(np.median(images, 0).astype(np.uint8))
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
