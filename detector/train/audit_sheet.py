"""The picture that a person looks at: the region enlarged, with numbered candidates.

Owns the layout and the drawing; `audit.py` says what the candidates are.
"""

import cv2
import numpy as np

from audit_boxes import SHIPPED


def draw_sheet(img, polygons, found):
    """The far third of the region enlarged further, above the rest; lines stay thin."""
    points = np.concatenate([np.array(p) for p in polygons])
    (x0, y0), (x1, y1) = points.min(0), points.max(0)
    cut = y0 + (y1 - y0) * 0.36
    far = np.concatenate([edge_points(p, cut) for p in polygons])
    # Room for the vehicles that stand on the far edge, and for some context.
    room = 0.12 * (y1 - y0)
    parts = [(far[:, 0].min() - room, y0 - room, far[:, 0].max() + room, cut + room / 3, 7.0),
             (x0 - room, cut - room / 2, x1 + room, y1, 4.5)]
    return stack([panel(img, polygons, found, p) for p in parts])


def edge_points(polygon, cut):
    """Points along a polygon's edge above `cut`."""
    ring = np.array(polygon + polygon[:1], float)
    steps = np.concatenate([np.linspace(a, b, 20) for a, b in zip(ring, ring[1:])])
    return steps[steps[:, 1] <= cut]


def panel(img, polygons, found, part, most=1250, tall=480):
    height, width = img.shape[:2]
    x0, y0 = max(0, int(part[0])), max(0, int(part[1]))
    x1, y1 = min(width, int(part[2])), min(height, int(part[3]))
    k = min(part[4], most / (x1 - x0), tall / (y1 - y0))
    size = round((x1 - x0) * k), round((y1 - y0) * k)
    out = cv2.resize(img[y0:y1, x0:x1], size, interpolation=cv2.INTER_CUBIC)
    at = lambda p: tuple(int(round(v)) for v in ((p[0] - x0) * k, (p[1] - y0) * k))
    for polygon in polygons:
        cv2.polylines(out, [np.array([at(p) for p in polygon])], True, (200, 120, 0), 1)
    step = 20 if k > 3 else 40
    for v in range(x0 // step * step + step, x1, step):
        cv2.putText(out, str(v), (at((v, 0))[0] - 8, 9), 0, 0.35, (0, 255, 255), 1)
        cv2.line(out, (at((v, 0))[0], 11), (at((v, 0))[0], 16), (0, 255, 255), 1)
    for v in range(y0 // step * step + step, y1, step):
        cv2.putText(out, str(v), (0, at((0, v))[1] + 4), 0, 0.35, (0, 255, 255), 1)
    for number, box in enumerate(found, 1):
        if not y0 <= box[3] <= y1 + 1:
            continue
        colour = ((255, 255, 0) if box[6] == "label"
                  else (0, 255, 0) if box[5] >= SHIPPED else (0, 140, 255))
        a, b = at(box[:2]), at(box[2:4])
        corners(out, a, b, colour)
        side = [(b[0] + 1, a[1] + 10), (b[0] + 1, b[1]), (a[0] - 17, a[1] + 10), (a[0] - 17, b[1])]
        x, y = side[number % 4]
        place = (min(max(x, 0), out.shape[1] - 17), y)
        cv2.putText(out, str(number), place, 0, 0.42, (0, 0, 0), 3)
        cv2.putText(out, str(number), place, 0, 0.42, colour, 1)
    return out


def corners(out, a, b, colour):
    """Only the corners of a box, so that the vehicle stays visible."""
    dx, dy = max(2, (b[0] - a[0]) // 5), max(2, (b[1] - a[1]) // 5)
    for x, sx in ((a[0], 1), (b[0], -1)):
        for y, sy in ((a[1], 1), (b[1], -1)):
            cv2.line(out, (x, y), (x + sx * dx, y), colour, 1)
            cv2.line(out, (x, y), (x, y + sy * dy), colour, 1)


def stack(panels):
    width = max(p.shape[1] for p in panels)
    panels = [cv2.copyMakeBorder(p, 0, 4, 0, width - p.shape[1], cv2.BORDER_CONSTANT)
              for p in panels]
    return np.vstack(panels)
