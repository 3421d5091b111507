"""Boxes of a teacher, once: the whole picture and, if asked, enlarged tiles of it.

The first teacher is the COCO model; a trained model of ours (`--columns 0,1,2,3,4`) is the next.

They never become truth on test cameras; training uses them where a data set leaves far
vehicles unlabelled. Writes one pickle: {path: float32 rows x0 y0 x1 y1 score}.
"""

import argparse
import pickle
import time

import cv2
import numpy as np
import onnxruntime as ort

import boxes
import data
import road

COCO_VEHICLES = "2,3,5,7"  # car, motorcycle, bus, truck


class Detector:
    """An ONNX detector with a fixed input, run by ONNX Runtime."""

    def __init__(self, path, columns, threads=1):
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        self.session = ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        entry = self.session.get_inputs()[0]
        self.name, (_, _, self.height, self.width) = entry.name, entry.shape
        self.grid = boxes.centres(self.width, self.height)
        self.columns = columns

    def raw(self, img, floor):
        img, place = boxes.letterbox(img, self.width, self.height)
        out = self.session.run(None, {self.name: boxes.blob(img)})[0][0]
        return boxes.decode(out, self.grid, self.columns, floor), place

    def detect(self, img, floor=0.02, overlap=0.6):
        rows, place = self.raw(img, floor)
        return boxes.to_picture(boxes.nms(rows, overlap), place, img.shape[1], img.shape[0])


def tiles(detector, img, floor, zoom=1.75):
    """Detections of overlapping tiles of the enlarged picture; cut vehicles are dropped."""
    h, w = img.shape[:2]
    scale = min(detector.width / w, detector.height / h) * zoom
    tw, th = min(w, detector.width / scale), min(h, detector.height / scale)
    found = []
    for x0 in np.linspace(0, w - tw, 2):
        for y0 in np.linspace(0, h - th, 2):
            x, y, x1, y1 = int(x0), int(y0), int(x0 + tw), int(y0 + th)
            part = img[y:y1, x:x1]
            rows, place = detector.raw(part, floor)
            rows = boxes.to_picture(rows, place, part.shape[1], part.shape[0])
            edge = 3
            inner = np.ones(len(rows), bool)
            inner &= (rows[:, 0] > edge) | (x == 0)
            inner &= (rows[:, 1] > edge) | (y == 0)
            inner &= (rows[:, 2] < part.shape[1] - edge) | (x1 >= w - 1)
            inner &= (rows[:, 3] < part.shape[0] - edge) | (y1 >= h - 1)
            rows = rows[inner]
            rows[:, [0, 2]] += x
            rows[:, [1, 3]] += y
            found.append(rows)
    return np.concatenate(found)


def main():
    args = argparse.ArgumentParser(description=__doc__)
    args.add_argument("--data", required=True, help="the folder with sg_lta, atl_v2, ...")
    args.add_argument("--model", required=True, help="NanoDet-Plus-m, 640x480, ONNX")
    args.add_argument("--columns", default=COCO_VEHICLES, help="score columns that are vehicles")
    args.add_argument("--out", required=True)
    args.add_argument("--floor", type=float, default=0.08)
    args.add_argument("--tiles", action="store_true", help="enlarged tiles too: five times the work")
    args = args.parse_args()
    detector = Detector(args.model, [int(c) for c in args.columns.split(",")])
    pictures = [p for p in data.load_all(args.data) if p.split == "train"]
    found, start = {}, time.time()
    for i, p in enumerate(pictures):
        img = p.read()
        whole, place = detector.raw(img, args.floor)
        whole = boxes.to_picture(whole, place, img.shape[1], img.shape[0])
        if args.tiles:
            whole = np.concatenate([whole, tiles(detector, img, args.floor)])
        found[p.path] = boxes.nms(whole, 0.55)[:, :5].astype(np.float32)
        if i % 50 == 0:
            print(f"{i}/{len(pictures)} {time.time() - start:.0f} s", flush=True)
    print(f"{road.settle(pictures, found)} boxes show the road and went")
    with open(args.out, "wb") as file:
        pickle.dump(found, file)


if __name__ == "__main__":
    main()
