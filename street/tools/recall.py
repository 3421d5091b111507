#!/usr/bin/env python3
"""Recall of a detector trained on photographs on recordings of the simulated street.

Runs NanoDet-Plus (COCO, ONNX) over the frames of one or more recordings and counts which true
vehicles it finds. Owns decoding and matching; prints one row per recording. Vehicles hidden by
more than --max-occlusion, cut by the picture's edge, or less high than --min-height are neither
asked for nor counted as false.

    python3 street/tools/recall.py --model MODEL.onnx RECORDING...

Needs numpy, pillow, onnxruntime. Exit codes: 0 done, 66 model or recording missing, 69 a
package missing.
"""
import argparse
import json
import pathlib
import sys

VEHICLES = {2: "car", 3: "motorcycle", 5: "bus", 7: "truck"}
STRIDES = (8, 16, 32, 64)
BINS = 8  # distribution focal loss: 8 values per side
MEAN = (103.53, 116.28, 123.675)  # BGR
STD = (57.375, 57.12, 58.395)


def detect(np, session, picture, threshold):
    """Boxes [x0, y0, x1, y1, score] in px of the picture, after suppression at IoU 0.6."""
    name = session.get_inputs()[0].name
    _, _, height, width = session.get_inputs()[0].shape
    scale_x, scale_y = width / picture.width, height / picture.height
    pixels = np.asarray(picture.resize((width, height)), np.float32)[:, :, ::-1]
    tensor = ((pixels - MEAN) / STD).astype(np.float32).transpose(2, 0, 1)[None]
    out = session.run(None, {name: tensor})[0][0]
    scores = out[:, :80]
    if scores.min() < 0 or scores.max() > 1:
        scores = 1 / (1 + np.exp(-scores))
    centres = []
    for stride in STRIDES:
        rows, columns = -(-height // stride), -(-width // stride)
        y, x = np.mgrid[:rows, :columns]
        centres.append(np.stack([x.ravel() * stride, y.ravel() * stride, np.full(x.size, stride)], 1))
    centres = np.concatenate(centres).astype(np.float32)
    sides = out[:, 80:].reshape(-1, 4, BINS)
    sides = np.exp(sides - sides.max(2, keepdims=True))
    sides = (sides / sides.sum(2, keepdims=True)) @ np.arange(BINS) * centres[:, 2:]
    best = scores[:, list(VEHICLES)].max(1)
    keep = best > threshold
    boxes = np.concatenate([centres[keep, :2] - sides[keep, :2], centres[keep, :2] + sides[keep, 2:]], 1)
    boxes /= (scale_x, scale_y, scale_x, scale_y)
    found = []
    for i in np.argsort(-best[keep]):
        if all(iou(boxes[i], other) < 0.6 for other in found):
            found.append([*boxes[i], best[keep][i]])
    return found


def iou(a, b):
    """Intersection over union of two boxes; more than four numbers are ignored."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    common = width * height
    return common / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common)


def measure(np, image, session, folder, args):
    """Counts of one recording: asked, found, and detections that match no listed vehicle."""
    asked = found = wrong = 0
    by_class = {}
    for line in (folder / "truth.jsonl").read_text().splitlines():
        truth = json.loads(line)
        picture = image.open(folder / "frames" / truth["frame"]).convert("RGB")
        detections = detect(np, session, picture, args.threshold)
        used = set()
        for vehicle in truth["vehicles"]:
            x0, y0, x1, y1 = box = vehicle["box"]
            whole = x0 > 1 and y0 > 1 and x1 < picture.width - 1 and y1 < picture.height - 1
            overlaps = [iou(box, d) if i not in used else 0.0 for i, d in enumerate(detections)]
            hit = max(range(len(overlaps)), key=overlaps.__getitem__, default=None)
            matched = hit is not None and overlaps[hit] >= args.iou
            if matched:
                used.add(hit)
            if not whole or vehicle["occlusion"] > args.max_occlusion or y1 - y0 < args.min_height:
                continue
            asked += 1
            found += matched
            counts = by_class.setdefault(vehicle["class"], [0, 0])
            counts[0] += 1
            counts[1] += matched
        wrong += sum(d[4] >= args.threshold and i not in used and d[3] - d[1] >= args.min_height
                     for i, d in enumerate(detections))
    return asked, found, wrong, by_class


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="+", type=pathlib.Path)
    parser.add_argument("--model", required=True, type=pathlib.Path)
    parser.add_argument("--threshold", type=float, default=0.3, help="least score")
    parser.add_argument("--iou", type=float, default=0.5, help="least overlap of a match")
    parser.add_argument("--min-height", type=float, default=24.0, help="px of the frame")
    parser.add_argument("--max-occlusion", type=float, default=0.3)
    args = parser.parse_args()
    try:
        import numpy as np
        import onnxruntime
        from PIL import Image
    except ImportError as fault:
        print(f"recall: {fault}; install numpy, pillow and onnxruntime", file=sys.stderr)
        return 69
    for path in [args.model, *(folder / "truth.jsonl" for folder in args.recordings)]:
        if not path.is_file():
            print(f"recall: {path} is missing", file=sys.stderr)
            return 66
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(args.model), options)
    print("| recording | vehicles | found | recall | unmatched boxes | by class |")
    print("|---|---|---|---|---|---|")
    for folder in args.recordings:
        asked, found, wrong, by_class = measure(np, Image, session, folder, args)
        classes = ", ".join(f"{k} {v[1]}/{v[0]}" for k, v in sorted(by_class.items()))
        print(f"| {folder.name} | {asked} | {found} | {found / max(asked, 1):.3f} | {wrong} | {classes} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
