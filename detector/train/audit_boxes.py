"""Boxes of the shipped network on the audited frames, at any input size.

Owns the graph at another size and the suppression as the daemon does it.

    python3 audit_boxes.py --out FILE.jsonl [--size 960x736 --score 0.39]
"""

import argparse
import glob
import json
import os

import cv2
import numpy as np

import boxes
import data
from evidence_frames import overlaps
from teacher import Detector

HERE = os.path.dirname(os.path.abspath(__file__))
DATA = os.path.join(HERE, "..", "..", "..", "shared", "data")
AUDIT = os.path.join(HERE, "..", "data", "audit")
MODEL = os.path.join(HERE, "..", "..", "models", "verge_nanodet_640x480.onnx")
SHIPPED, UNION, SMALLER = 0.315, 0.5, 0.8  # models/verge_nanodet_640x480.toml
MOST = 1024  # candidates of a frame, as in the daemon


def share(inner, outer):
    """The part of `inner` that lies in `outer`."""
    w = min(inner[2], outer[2]) - max(inner[0], outer[0])
    h = min(inner[3], outer[3]) - max(inner[1], outer[1])
    return max(0, w) * max(0, h) / max(1e-6, (inner[2] - inner[0]) * (inner[3] - inner[1]))


def read(root, frame):
    """BGR pixels of a picture or of one frame of a video."""
    path, _, number = frame.partition("#")
    path = os.path.join(root, path)
    if not number:
        img = cv2.imread(path, cv2.IMREAD_COLOR)
    else:
        video = cv2.VideoCapture(path)
        video.set(cv2.CAP_PROP_POS_FRAMES, int(number))
        img = video.read()[1]
    if img is None:
        raise OSError(f"{frame}: nothing that OpenCV reads")
    return img


def rows_of(path):
    with open(path) as file:
        return [json.loads(line) for line in file]


def all_rows():
    return [r for f in sorted(glob.glob(os.path.join(AUDIT, "*.jsonl"))) for r in rows_of(f)]


def resized(path, width, height):
    """The shipped graph at another input size: the same weights, other shape constants."""
    import onnx
    from onnx import numpy_helper

    model = onnx.load(path)
    entry = model.graph.input[0].type.tensor_type.shape.dim
    old = entry[3].dim_value, entry[2].dim_value
    entry[2].dim_value, entry[3].dim_value = height, width
    shapes = {node.input[1] for node in model.graph.node if node.op_type == "Reshape"}
    for item in model.graph.initializer:
        if item.name in shapes:
            value = numpy_helper.to_array(item).copy()
            if len(value) >= 4 and value[-1] > 0:
                stride = old[0] // value[-1]
                value[-2:] = -(-height // stride), -(-width // stride)
                item.CopyFrom(numpy_helper.from_array(value, item.name))
    del model.graph.value_info[:]
    rows = model.graph.output[0].type.tensor_type.shape.dim[1]
    rows.dim_value = len(boxes.centres(width, height))
    return model.SerializeToString()


def detectors():
    names = list(range(len(data.CLASSES) - 1))
    return [Detector(MODEL, names), Detector(resized(MODEL, 960, 736), names)]


def suppressed(rows, union, smaller):
    """Greedy, as the daemon does it: by overlap over the union and over the smaller box."""
    rows = rows[np.argsort(-rows[:, 4], kind="stable")][:MOST]
    over_union, over_smaller = overlaps(rows, rows)
    kept = []
    for i in range(len(rows)):
        if (over_union[i, kept] <= union).all() and (over_smaller[i, kept] <= smaller).all():
            kept.append(i)
    return rows[kept]


def write(args):
    """Detections of a network on every audited frame, for `count_audit.py`."""
    names = list(range(len(data.CLASSES) - 1))
    width, height = (int(v) for v in args.size.split("x"))
    path = args.model if (width, height) == (640, 480) else resized(args.model, width, height)
    net = Detector(path, names)
    with open(args.out, "w") as file:
        for row in all_rows():
            img = read(args.data, row["frame"])
            tall, wide = img.shape[:2]
            squeezed = row["frame"].startswith("topview") and wide == tall
            if squeezed:
                img = cv2.resize(img, (wide, round(wide * 9 / 16)), interpolation=cv2.INTER_AREA)
            rows, place = net.raw(img, args.score)
            rows = suppressed(rows, args.union, args.smaller)
            rows = boxes.to_picture(rows, place, img.shape[1], img.shape[0])
            rows[:, [1, 3]] *= tall / img.shape[0]
            found = [[*(round(float(v), 2) for v in r[:4]), round(float(r[4]), 5),
                      data.CLASSES[int(r[5]) + 1]] for r in rows]
            file.write(json.dumps({"frame": row["frame"], "boxes": found}) + "\n")


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--data", default=DATA)
    args.add_argument("--out", required=True)
    args.add_argument("--model", default=MODEL)
    args.add_argument("--size", default="640x480", help="input of the network")
    args.add_argument("--score", type=float, default=SHIPPED)
    args.add_argument("--union", type=float, default=UNION)
    args.add_argument("--smaller", type=float, default=SMALLER)
    write(args.parse_args())


if __name__ == "__main__":
    main()
