"""Vehicles of a fixed camera pasted into other pictures of it, and marks that are no vehicles.

A vehicle is cut out by its difference from the road without vehicles (the median of the camera's pictures
in one light) and pasted at its own place, so that size and view are right there: into empty road, beside
others, nose to tail with them. Marks are letters and arrows, painted on the road or burnt into the
picture, and shadows of masts and leaves: pixels that change without a box.
"""

import cv2
import numpy as np

import road

SMALLEST = 8  # px of the stored picture: the shorter side of a vehicle that is cut out
EDGE = 3  # px around a box that are cut out with it
FILLED = 0.45  # part of the box that differs from the road, at least
MOST_HIDDEN = 0.7  # a vehicle hidden further is ignored, as everywhere in training
CROWD = 8  # vehicles that are pasted at most
INSIDE = 0.6  # of the smaller of two boxes that a pasted vehicle may share with another


class Stock:
    """What was cut out, by camera and light."""

    def __init__(self, pictures):
        self.vehicles, self.still = {}, set()
        for members, images, empty in road.cameras(pictures):
            self.vehicles[road.name(members[0])] = list(cut_out(members, images, empty))
            self.still.update(p.path for p in members)

    def __len__(self):
        return sum(len(v) for v in self.vehicles.values())

    def crowd(self, picture, img, truth, kinds, ignored, rng):
        """The picture with more vehicles, and its boxes, kinds and ignored boxes."""
        known = self.vehicles.get(road.name(picture))
        if not known or picture.path not in self.still:
            return img, truth, kinds, ignored
        img, hidden = img.copy(), np.zeros(len(truth))
        touching = rng.random() < 0.6
        wanted = int(rng.integers(1, CROWD + 1))
        for n in rng.permutation(len(known))[:60]:
            if wanted == 0:
                break
            box, kind, pixels, alpha = known[n]
            both, smaller = shared(box, truth)
            if smaller.max(initial=0) > INSIDE or (touching and rng.random() < 0.8
                                                and smaller.max(initial=0) < 0.02):
                continue
            left, top = int(box[0]) - EDGE, int(box[1]) - EDGE
            h, w = alpha.shape
            alpha = alpha.copy()
            for front in truth[(truth[:, 3] > box[3]) & (both > 0)]:
                x0, y0, x1, y1 = (front - [left, top, left, top]).round().astype(int)
                alpha[max(y0, 0):max(y1, 0), max(x0, 0):max(x1, 0)] = 0
            seen = (alpha > 0.5).sum() / (known[n][3] > 0.5).sum()
            if seen < 1 - MOST_HIDDEN:
                continue
            place = img[top:top + h, left:left + w]
            gain = float(np.clip(ring(place, known[n][3]) / ring(pixels, known[n][3]), 0.7, 1.4))
            mixed = place * (1 - alpha[..., None]) + pixels * (gain * alpha[..., None])
            img[top:top + h, left:left + w] = np.clip(mixed, 0, 255).astype(np.uint8)
            for i in np.flatnonzero(both > 0):
                x0, y0, x1, y1 = (truth[i] - [left, top, left, top]).round().astype(int)
                covered = (alpha[max(y0, 0):max(y1, 0), max(x0, 0):max(x1, 0)] > 0.5).sum()
                hidden[i] += covered / max((truth[i, 2:] - truth[i, :2]).prod(), 1)
            truth = np.concatenate([truth, box[None]]).astype(np.float32)
            kinds, hidden = np.append(kinds, kind), np.append(hidden, 1 - seen)
            wanted -= 1
        gone = hidden > MOST_HIDDEN
        return img, truth[~gone], kinds[~gone], np.concatenate([ignored, truth[gone]])


def cut_out(pictures, images, empty):
    """Box, kind, pixels and cover (0..1) of each vehicle that stands alone."""
    for picture, img in zip(pictures, images):
        truth, kinds, _ = picture.targets()
        change = np.abs(img.astype(np.float32) - empty.astype(np.float32)).max(2)
        level = max(18.0, 2.5 * float(np.median(change)))
        for n, box in enumerate(truth):
            x0, y0, x1, y1 = int(box[0]) - EDGE, int(box[1]) - EDGE, int(box[2]) + EDGE, int(box[3]) + EDGE
            if x0 < 0 or y0 < 0 or x1 > img.shape[1] or y1 > img.shape[0]:
                continue
            others = np.delete(truth, n, 0)
            if (box[2:] - box[:2]).min() < SMALLEST or shared(box, others)[1].max(initial=0) > 0.05:
                continue
            mask = (change[y0:y1, x0:x1] > level).astype(np.uint8)
            mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
            outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            if not outlines:
                continue
            hull = cv2.convexHull(max(outlines, key=cv2.contourArea))
            mask = cv2.fillConvexPoly(np.zeros_like(mask), hull, 1)
            if mask[EDGE:-EDGE, EDGE:-EDGE].mean() < FILLED or mask.all():
                continue
            alpha = cv2.GaussianBlur(cv2.dilate(mask, np.ones((3, 3), np.uint8)).astype(np.float32), (0, 0), 0.8)
            yield box, int(kinds[n]), img[y0:y1, x0:x1].copy(), alpha


def shared(box, others):
    """Area that `box` shares with each of the others, and as a part of the smaller of both."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:4])
    both = np.clip(high - low, 0, None).prod(1)
    area = (others[:, 2:4] - others[:, :2]).prod(1)
    return both, both / np.maximum(np.minimum(area, (box[2:] - box[:2]).prod()), 1e-6)


def ring(pixels, alpha):
    """Brightness beside the vehicle."""
    beside = pixels[alpha < 0.1]
    return float(np.median(beside)) + 8 if len(beside) else 100.0


LETTERS = "ABCDEFGHIJKLMNOPRSTUVWXY"
WORDS = ["SLOW", "BUS", "STOP", "AHEAD", "KEEP", "CLEAR", "TAXI", "ONLY", "LANE", "EXIT", "20", "50"]
INKS = [(255, 255, 255), (0, 0, 0), (0, 230, 255), (40, 40, 230), (255, 200, 60), (60, 220, 60)]


def marks(img, truth, rng):
    """A window with one to three marks, and which boxes what is burnt in covers further than a vehicle
    may be hidden."""
    img, over = img.copy(), np.zeros(img.shape[:2], bool)
    for _ in range(int(rng.integers(1, 4))):
        mark = [burnt_words, burnt_arrow, painted, painted, shadow][int(rng.integers(5))]
        before = img.copy()
        mark(img, truth, rng)
        if mark in (burnt_words, burnt_arrow):
            over |= (img != before).any(2)
    corners = [box.round().astype(int) for box in truth]
    return img, np.array([over[y0:y1, x0:x1].mean() > MOST_HIDDEN if x1 > x0 and y1 > y0 else False
                          for x0, y0, x1, y1 in corners], bool)


def burnt_words(img, _truth, rng):
    """Words as a camera burns them in: over road and vehicles alike."""
    h, w = img.shape[:2]
    size, thick = float(rng.uniform(0.3, 1.0)), int(rng.integers(1, 3))
    length = int(rng.integers(3, 18))
    text = "".join(rng.choice(list(LETTERS + "0123456789:-/ "), length))
    at = int(rng.integers(-20, w - 20)), int(rng.integers(10, h))
    (across, up), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, thick)
    if rng.random() < 0.25:
        back = (at[0] - 2, at[1] - up - 2), (at[0] + across + 2, at[1] + below)
        cv2.rectangle(img, *back, INKS[int(rng.integers(2))], -1)
    ink = INKS[int(rng.integers(len(INKS)))]
    if rng.random() < 0.5:
        cv2.putText(img, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), thick + 2, cv2.LINE_AA)
    cv2.putText(img, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, ink, thick, cv2.LINE_AA)


def burnt_arrow(img, _truth, rng):
    h, w = img.shape[:2]
    tail = rng.uniform(0, [w, h])
    way = rng.uniform(-1, 1, 2) * rng.uniform(15, 90)
    cv2.arrowedLine(img, tuple(int(v) for v in tail), tuple(int(v) for v in tail + way),
                    INKS[int(rng.integers(len(INKS)))], int(rng.integers(2, 6)), cv2.LINE_AA,
                    tipLength=float(rng.uniform(0.25, 0.5)))


def painted(img, truth, rng):
    """A word, an arrow or bars on the road, foreshortened, where no vehicle stands."""
    h, w = img.shape[:2]
    typical = np.median(truth[:, 2] - truth[:, 0]) if len(truth) else 0.08 * w
    wide = max(8, int(typical * rng.uniform(0.4, 1.3)))
    tall = max(5, int(wide * rng.uniform(0.4, 1.6)))
    x, y = int(rng.integers(0, max(w - wide, 1))), int(rng.integers(h // 5, max(h - tall, h // 5 + 1)))
    part = img[y:y + tall, x:x + wide]
    tall, wide = part.shape[:2]
    if tall < 4 or wide < 4 or shared(np.array([x, y, x + wide, y + tall], np.float32), truth)[1].max(initial=0) > 0.02:
        return
    flat = np.zeros((160, 96), np.uint8)
    kind = rng.integers(3)
    if kind == 0:
        for row, word in enumerate(rng.choice(WORDS, int(rng.integers(1, 3)))):
            cv2.putText(flat, str(word), (4, 70 + 80 * row), cv2.FONT_HERSHEY_SIMPLEX,
                        3.2 / max(len(word), 2), 255, 7, cv2.LINE_AA)
    elif kind == 1:
        ends = [((48, 155), (48, 10)), ((48, 10), (48, 155)), ((20, 150), (80, 40))][int(rng.integers(3))]
        cv2.arrowedLine(flat, *ends, 255, 14, cv2.LINE_AA, tipLength=0.3)
    else:
        for start in range(0, 160, 32):
            cv2.rectangle(flat, (4, start), (91, start + 14), 255, -1)
    slant = float(rng.uniform(-0.35, 0.35)) * wide
    near = np.float32([[0, 0], [96, 0], [96, 160], [0, 160]])
    inset = 0.15 * wide
    seen = np.float32([[inset + max(slant, 0), 0], [wide - inset + min(slant, 0), 0],
                       [wide + min(-slant, 0), tall], [max(-slant, 0), tall]])
    # Drawn four times as large, then averaged: thin strokes fade as they do in a camera.
    way = cv2.getPerspectiveTransform(near, 4 * seen)
    cover = cv2.resize(cv2.warpPerspective(flat, way, (4 * wide, 4 * tall)), (wide, tall),
                       interpolation=cv2.INTER_AREA)
    cover = cover.astype(np.float32) * (rng.uniform(0.45, 0.95) / 255)
    bright = np.percentile(img, 90) if rng.random() < 0.7 else 0.6 * img.mean() + 80
    ink = np.array([bright * (0.55 if rng.random() < 0.2 else 1), bright, bright], np.float32)
    part[:] = np.clip(part * (1 - cover[..., None]) + ink * cover[..., None], 0, 255).astype(np.uint8)


def shadow(img, _truth, rng):
    """Of a mast, or of leaves: darker, over road and vehicles alike."""
    h, w = img.shape[:2]
    shade = np.zeros((h, w), np.uint8)
    if rng.random() < 0.5:
        a, b = rng.uniform(0, [w, h]), rng.uniform(0, [w, h])
        cv2.line(shade, tuple(int(v) for v in a), tuple(int(v) for v in b), 255, int(rng.integers(2, 14)), cv2.LINE_AA)
    else:
        centre, reach = rng.uniform(0, [w, h]), rng.uniform(15, 70)
        for _ in range(int(rng.integers(15, 60))):
            at = centre + rng.normal(0, reach, 2) * [1, 0.6]
            cv2.circle(shade, tuple(int(v) for v in at), int(rng.integers(2, 12)), 255, -1)
    shade = cv2.GaussianBlur(shade, (0, 0), float(rng.uniform(0.6, 2.5)))
    img[:] = (img * (1 - rng.uniform(0.3, 0.6) * shade[..., None] / 255)).astype(np.uint8)
