"""Letterbox, decode and non-maximum suppression: the same arithmetic as the daemon's.

Owns the geometry between picture and network input. Boxes are x0 y0 x1 y1 score [class].
"""

import cv2
import numpy as np

MEAN = np.array([103.53, 116.28, 123.675], np.float32)
STD = np.array([57.375, 57.12, 58.395], np.float32)
GREY = 114
STRIDES = (8, 16, 32, 64)
BINS = 8


def letterbox(img, width, height):
    """Scaled to fit, centred, padded with grey. Returns pixels and (scale, dx, dy)."""
    h, w = img.shape[:2]
    scale = min(width / w, height / h)
    nw, nh = min(width, round(w * scale)), min(height, round(h * scale))
    dx, dy = (width - nw) // 2, (height - nh) // 2
    out = np.full((height, width, 3), GREY, np.uint8)
    # Shrinking averages, as the daemon's does; enlarging is linear.
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    out[dy:dy + nh, dx:dx + nw] = cv2.resize(img, (nw, nh), interpolation=how)
    return out, (nw / w, dx, dy)


def blob(img):
    return ((img.astype(np.float32) - MEAN) / STD).transpose(2, 0, 1)[None]


def centres(width, height):
    """Centre x, centre y, stride of every output row, in the order of the export."""
    rows = []
    for s in STRIDES:
        ys, xs = np.meshgrid(np.arange(-(-height // s)), np.arange(-(-width // s)), indexing="ij")
        rows.append(np.stack([xs.ravel() * s, ys.ravel() * s, np.full(xs.size, s)], 1))
    return np.concatenate(rows).astype(np.float32)


def decode(out, grid, columns, floor):
    """Rows above `floor` as x0 y0 x1 y1 score column, in network pixels."""
    classes = out.shape[1] - 4 * BINS
    scores = out[:, columns]
    best = scores.argmax(1)
    score = scores[np.arange(len(best)), best]
    keep = score > floor
    bins = out[keep, classes:].reshape(-1, 4, BINS)
    bins = np.exp(bins - bins.max(2, keepdims=True))
    dist = (bins / bins.sum(2, keepdims=True)) @ np.arange(BINS, dtype=np.float32)
    x, y, s = grid[keep].T
    d = dist * s[:, None]
    box = np.stack([x - d[:, 0], y - d[:, 1], x + d[:, 2], y + d[:, 3]], 1)
    return np.concatenate([box, score[keep, None], np.asarray(columns)[best[keep], None]], 1)


def iou(a, b):
    lt = np.maximum(a[:, None, :2], b[None, :, :2])
    rb = np.minimum(a[:, None, 2:4], b[None, :, 2:4])
    inter = np.clip(rb - lt, 0, None).prod(2)
    area = lambda x: np.clip(x[:, 2:4] - x[:, :2], 0, None).prod(1)
    return inter / (area(a)[:, None] + area(b)[None] - inter + 1e-9)


def nms(boxes, threshold, top=300):
    """Class-agnostic greedy suppression; a tie keeps the earlier row."""
    boxes = boxes[np.argsort(-boxes[:, 4], kind="stable")]
    kept = []
    while len(boxes) and len(kept) < top:
        kept.append(boxes[0])
        boxes = boxes[1:][iou(boxes[:1], boxes[1:])[0] <= threshold]
    return np.array(kept).reshape(-1, 6)


def to_picture(boxes, place, width, height):
    """From network pixels back to the pixels of the picture, clipped to it."""
    scale, dx, dy = place
    out = boxes.copy()
    out[:, [0, 2]] = np.clip((boxes[:, [0, 2]] - dx) / scale, 0, width)
    out[:, [1, 3]] = np.clip((boxes[:, [1, 3]] - dy) / scale, 0, height)
    return out
