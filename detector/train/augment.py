"""From a labelled picture to a training window: scale, crop, flip, light, blur, noise, JPEG.

A window is cut from the picture as the daemon would enlarge it (640x480 letterbox), times a
random zoom, so vehicles keep the sizes that they have in use. Owns all randomness of the data.
"""

from dataclasses import dataclass

import cv2
import numpy as np

import boxes as geometry
import paste

FULL = (640, 480)
SMALLEST = 5  # px of the window: below, a label is ignored and not taught


@dataclass
class Recipe:
    """What is done to a picture beyond what `window` always does."""

    zoom: tuple = (0.6, 1.7)  # of the 640x480 letterbox
    crowd: float = 0.0  # chance that vehicles of the same camera are pasted in
    marks: float = 0.0  # chance of marks that are no vehicles
    stock: object = None  # `paste.Stock`


def window(picture, rng, width, height, recipe, zoom):
    """One random window of the picture with its boxes."""
    img = picture.read()
    truth, kinds, ignored = picture.targets()
    if recipe.stock is not None and rng.random() < recipe.crowd:
        img, truth, kinds, ignored = recipe.stock.crowd(picture, img, truth, kinds, ignored, rng)
    h, w = img.shape[:2]
    base = min(FULL[0] / w, FULL[1] / h)
    scale = base * np.exp(rng.uniform(np.log(zoom[0]), np.log(zoom[1])))
    stretch = rng.uniform(0.9, 1.1)
    sx, sy = scale * stretch, scale / stretch
    if rng.random() < 0.45:
        img = coarse(img, base, rng)
    nw, nh = max(32, round(w * sx)), max(32, round(h * sy))
    img = cv2.resize(img, (nw, nh), interpolation=cv2.INTER_LINEAR)
    grow = np.array([nw / w, nh / h] * 2, np.float32)
    truth, ignored = truth * grow, ignored * grow
    if len(truth) and rng.random() < 0.75:
        x0, y0, x1, y1 = truth[rng.integers(len(truth))]
        left = (x0 + x1) / 2 - rng.uniform(0.15, 0.85) * width
        top = (y0 + y1) / 2 - rng.uniform(0.15, 0.85) * height
    else:
        left, top = rng.uniform(0, max(nw - width, 0)), rng.uniform(0, max(nh - height, 0))
    left = place(left, nw, width, rng)
    top = place(top, nh, height, rng)
    out = np.full((height, width, 3), geometry.GREY, np.uint8)
    sx0, sy0, dx0, dy0 = max(left, 0), max(top, 0), max(-left, 0), max(-top, 0)
    cw, ch = min(nw - sx0, width - dx0), min(nh - sy0, height - dy0)
    out[dy0:dy0 + ch, dx0:dx0 + cw] = img[sy0:sy0 + ch, sx0:sx0 + cw]
    shift = np.array([left, top] * 2, np.float32)
    truth, kinds, ignored = clip(truth - shift, kinds, ignored - shift, width, height)
    if recipe.marks and rng.random() < recipe.marks:
        out, covered = paste.marks(out, truth, rng)
        ignored = np.concatenate([ignored, truth[covered]])
        truth, kinds = truth[~covered], kinds[~covered]
    return out, truth, kinds, ignored


def place(start, size, room, rng):
    """Left edge of the cut: inside the picture, or anywhere in the room when it fits."""
    if size <= room:
        return -int(rng.integers(0, room - size + 1))
    return int(np.clip(start, 0, size - room))


def clip(truth, kinds, ignored, width, height):
    """Cut to the window; a vehicle of which under 35 % is left is ignored."""
    def cut(rows):
        limit = np.array([width, height] * 2, np.float32)
        return np.clip(rows, 0, limit)
    area = lambda r: np.clip(r[:, 2:] - r[:, :2], 0, None).prod(1)
    seen = cut(truth)
    part = area(seen) / np.maximum(area(truth), 1e-6)
    side = np.clip(seen[:, 2:] - seen[:, :2], 0, None).min(1) if len(seen) else np.zeros(0)
    keep = (part >= 0.35) & (side >= SMALLEST)
    rest = seen[(part > 0) & ~keep]
    return seen[keep], kinds[keep], np.concatenate([rest, cut(ignored)])


def coarse(img, base, rng):
    """As a 320x240 camera would have it: shrink, then JPEG."""
    target = rng.uniform(0.42, 0.9) * base
    if target < 1:
        img = cv2.resize(img, None, fx=target, fy=target, interpolation=cv2.INTER_AREA)
    return jpeg(img, int(rng.integers(35, 92)))


def jpeg(img, quality):
    return cv2.imdecode(cv2.imencode(".jpg", img, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1)


def light(img, rng, night):
    """Gamma, gain, colour cast; darkening makes some day pictures into dusk."""
    gain = rng.uniform(0.75, 1.25)
    gamma = np.exp(rng.uniform(-0.35, 0.35))
    if not night and rng.random() < 0.2:
        gamma, gain = rng.uniform(1.5, 2.6), rng.uniform(0.6, 1.0)
    cast = rng.uniform(0.9, 1.1, 3)
    ramp = (np.arange(256) / 255.0) ** gamma * 255 * gain
    table = np.clip(ramp[:, None] * cast[None], 0, 255).astype(np.uint8)
    img = cv2.LUT(img, table[None].reshape(1, 256, 3))
    if rng.random() < 0.2:
        grey = cv2.cvtColor(img, cv2.COLOR_BGR2GRAY)[..., None]
        amount = rng.uniform(0.4, 1.0)
        img = (img * (1 - amount) + grey * amount).astype(np.uint8)
    return img


def degrade(img, rng):
    if rng.random() < 0.2:
        img = cv2.GaussianBlur(img, (0, 0), rng.uniform(0.4, 1.4))
    if rng.random() < 0.25:
        noise = rng.normal(0, rng.uniform(2, 10), img.shape[:2] + (1,))
        img = np.clip(img + noise, 0, 255).astype(np.uint8)
    return img


def sample(pictures, index, rng, width, height, recipe, mosaic=0.25):
    """One training picture: a window, or four smaller ones side by side."""
    if rng.random() >= mosaic:
        picture = pictures[index]
        img, truth, kinds, ignored = window(picture, rng, width, height, recipe, recipe.zoom)
        img = light(img, rng, picture.night)
    else:
        cx, cy = int(rng.uniform(0.35, 0.65) * width), int(rng.uniform(0.35, 0.65) * height)
        img = np.zeros((height, width, 3), np.uint8)
        parts = []
        spots = [(0, 0, cx, cy), (cx, 0, width, cy), (0, cy, cx, height), (cx, cy, width, height)]
        chosen = [index] + [int(i) for i in rng.integers(len(pictures), size=3)]
        for (x0, y0, x1, y1), i in zip(spots, chosen):
            part, t, k, g = window(pictures[i], rng, x1 - x0, y1 - y0, recipe, (0.5, 1.3))
            img[y0:y1, x0:x1] = light(part, rng, pictures[i].night)
            shift = np.array([x0, y0] * 2, np.float32)
            parts.append((t + shift, k, g + shift))
        truth, kinds, ignored = (np.concatenate(p) for p in zip(*parts))
    if rng.random() < 0.5:
        img = img[:, ::-1]
        truth, ignored = mirror(truth, width), mirror(ignored, width)
    img = degrade(np.ascontiguousarray(img), rng)
    return img, truth, kinds, ignored


def mirror(rows, width):
    return np.stack([width - rows[:, 2], rows[:, 1], width - rows[:, 0], rows[:, 3]], 1)
