"""Boxes of an ONNX detector as JSON Lines, for `verge-detector eval`.

    python3 detector/train/detect.py --model FILE --images DIR|LIST --out FILE.jsonl

`--columns` names the score columns that are vehicles (COCO: 2,3,5,7).
"""

import argparse
import glob
import json
import os

import cv2

from teacher import Detector


def pictures(where):
    if os.path.isdir(where):
        names = sorted(glob.glob(os.path.join(where, "*")))
        return [n for n in names if n.lower().endswith((".jpg", ".jpeg", ".png"))]
    with open(where) as file:
        return [line.strip() for line in file if line.strip()]


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--model", required=True)
    args.add_argument("--images", required=True)
    args.add_argument("--out", required=True)
    args.add_argument("--columns", default="0,1,2,3,4")
    args.add_argument("--names", default="car,van,bus,truck,motorcycle")
    args.add_argument("--floor", type=float, default=0.02)
    args.add_argument("--overlap", type=float, default=0.6)
    args.add_argument("--threads", type=int, default=1)
    args = args.parse_args()
    columns = [int(c) for c in args.columns.split(",")]
    names = dict(zip(columns, args.names.split(",")))
    detector = Detector(args.model, columns, args.threads)
    with open(args.out + ".part", "w") as out:
        for path in pictures(args.images):
            img = cv2.imread(path)
            h, w = img.shape[:2]
            # The square pictures of topview_vehicle are squeezed 16:9 ones.
            squeezed = "topview" in path and w == h
            if squeezed:
                img = cv2.resize(img, (w, round(w * 9 / 16)), interpolation=cv2.INTER_AREA)
            rows = detector.detect(img, args.floor, args.overlap)
            if squeezed:
                rows[:, [1, 3]] *= h / img.shape[0]
            found = [[*(round(float(v), 2) for v in r[:4]), round(float(r[4]), 5), names[int(r[5])]]
                     for r in rows]
            out.write(json.dumps({"frame": os.path.basename(path), "boxes": found}) + "\n")
    os.replace(args.out + ".part", args.out)


if __name__ == "__main__":
    main()
