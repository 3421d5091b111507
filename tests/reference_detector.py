"""An independent reading of a model: NumPy and ONNX Runtime, sharing no code with verge.

usage: reference_detector.py MODEL.onnx FOLDER COLUMNS VEHICLES IOU IOS

For every PNG in FOLDER prints {"frame": name, "boxes": [[x0, y0, x1, y1, score], ...]}, in
pixels of the frame, for a NanoDet-Plus model with COLUMNS score columns, of which VEHICLES
(numbers with commas between) are vehicles. Of two boxes the better stays where they overlap by
more than IOU (over the union) or IOS (over the smaller). A model whose file name begins with
"yolox" is read as a YOLOX model.
"""

import json
import pathlib
import sys

import numpy as np
import onnxruntime
from PIL import Image

SCORE = 0.3


def main(model, folder, columns, vehicles, iou, ios):
    vehicles = [int(column) for column in vehicles.split(",")]
    yolox = pathlib.Path(model).name.startswith("yolox")
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    _, _, height, width = session.get_inputs()[0].shape
    for path in sorted(pathlib.Path(folder).glob("*.png")):
        picture = Image.open(path).convert("RGB")
        scale = min(width / picture.width, height / picture.height)
        size = (round(picture.width * scale), round(picture.height * scale))
        left, top = (width - size[0]) // 2, (height - size[1]) // 2
        canvas = np.full((height, width, 3), 114.0, np.float32)
        bands = [band.convert("F").resize(size, Image.BILINEAR) for band in picture.split()]
        canvas[top:top + size[1], left:left + size[0]] = np.stack(bands, -1)
        bgr = canvas[..., ::-1]
        if not yolox:
            bgr = (bgr - [103.53, 116.28, 123.675]) / [57.375, 57.12, 58.395]
        feed = {session.get_inputs()[0].name: bgr.transpose(2, 0, 1)[None].astype(np.float32)}
        output = session.run(None, feed)[0][0]
        if yolox:
            boxes = decode_yolox(output, width, height, vehicles)
        else:
            boxes = decode(output, width, height, int(columns), vehicles)
        boxes = suppress(boxes, float(iou), float(ios))
        boxes[:, [0, 2]] = (boxes[:, [0, 2]] - left) / scale
        boxes[:, [1, 3]] = (boxes[:, [1, 3]] - top) / scale
        boxes[:, [0, 2]] = boxes[:, [0, 2]].clip(0, picture.width)
        boxes[:, [1, 3]] = boxes[:, [1, 3]].clip(0, picture.height)
        print(json.dumps({"frame": path.name, "boxes": boxes.tolist()}))


def grid(width, height, strides):
    """Column, row and stride of each cell."""
    cells = []
    for stride in strides:
        v, u = np.mgrid[: -(-height // stride), : -(-width // stride)]
        cells.append(np.stack([u.ravel(), v.ravel(), 0 * u.ravel() + stride], 1))
    return np.concatenate(cells).astype(np.float32)


def decode(output, width, height, columns, vehicles):
    cells = grid(width, height, (8, 16, 32, 64))
    points = cells[:, :2] * cells[:, 2:]
    scores = output[:, vehicles].max(1)
    bins = output[:, columns:].reshape(-1, 4, 8)
    weights = np.exp(bins - bins.max(2, keepdims=True))
    sides = (weights / weights.sum(2, keepdims=True)) @ np.arange(8) * cells[:, 2:]
    return np.concatenate([points - sides[:, :2], points + sides[:, 2:], scores[:, None]], 1)


def decode_yolox(output, width, height, vehicles):
    cells = grid(width, height, (8, 16, 32))
    scores = output[:, 4] * output[:, 5:][:, vehicles].max(1)
    centres = (output[:, :2] + cells[:, :2]) * cells[:, 2:]
    halves = np.exp(output[:, 2:4]) * cells[:, 2:] / 2
    return np.concatenate([centres - halves, centres + halves, scores[:, None]], 1)


def suppress(boxes, iou, ios):
    boxes = boxes[boxes[:, 4] >= SCORE]
    boxes = boxes[np.argsort(-boxes[:, 4], kind="stable")]
    kept = []
    for box in boxes:
        shared = [overlaps(box, better) for better in kept]
        if all(union <= iou and smaller <= ios for union, smaller in shared):
            kept.append(box)
    return np.array(kept).reshape(-1, 5)


def overlaps(a, b):
    """Intersection over the union, and over the smaller."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    inner = max(width, 0) * max(height, 0)
    area = lambda box: (box[2] - box[0]) * (box[3] - box[1])
    return inner / (area(a) + area(b) - inner), inner / min(area(a), area(b))


if __name__ == "__main__":
    main(*sys.argv[1:])
