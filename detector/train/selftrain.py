"""The program's own boxes on training pictures, as a teacher for the next net.

    python3 selftrain.py --data DIR --verge PROGRAM --work DIR --out FILE.pkl [--sheet FILE.jpg]

`verge detect` looks at all pictures of a camera together: it chooses the input by the size of its cars
(up to 960x736), knows the empty road, and weighs size, place and overlap. Its boxes become the teacher of
`train.py` as those of `teacher.py` do. `--sheet` draws boxes at random that would be taught though
nobody labelled them, for an audit by eye.
"""

import argparse
import json
import os
import pickle
import subprocess

import cv2
import numpy as np

import boxes as geometry
import data
import road

LEAST = 0.05
MODEL = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "models",
                     "verge_nanodet_640x480.toml")
TILE, COLUMNS = 128, 12  # px of a tile of the sheet; tiles in a row


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--data", required=True, help="the folder with sg_lta, atl_v2, ...")
    args.add_argument("--verge", required=True, help="the program")
    args.add_argument("--work", required=True, help="folder for the pictures as the program sees them")
    args.add_argument("--out", required=True)
    args.add_argument("--sheet", help="draw boxes that would be taught")
    args.add_argument("--seed", type=int, default=20210320)
    args = args.parse_args()
    cameras = {}
    for p in data.load_all(args.data):
        if p.split == "train":
            cameras.setdefault(f"{p.dataset}_{p.group}", []).append(p)
    found = {}
    for name, members in sorted(cameras.items()):
        found.update(search(args.verge, os.path.join(args.work, name), members))
    pictures = [p for members in cameras.values() for p in members]
    print(f"{road.settle(pictures, found)} boxes show the road and went")
    with open(args.out, "wb") as file:
        pickle.dump(found, file)
    if args.sheet:
        cv2.imwrite(args.sheet, sheet(pictures, found, np.random.default_rng(args.seed)))


def search(verge, folder, pictures):
    """Boxes of one camera's pictures: {path: rows x0 y0 x1 y1 score}."""
    os.makedirs(folder, exist_ok=True)
    names = {}
    for p in pictures:
        frame = os.path.splitext(p.name)[0] + ".png"
        names[frame] = p.path
        if not os.path.exists(os.path.join(folder, frame)):
            cv2.imwrite(os.path.join(folder, frame), p.read())
    out = folder + ".jsonl"
    subprocess.run([verge, "detect", "--model", MODEL, "--frames", folder, "--score", str(LEAST),
                    "--detections", out], check=True, stdout=subprocess.DEVNULL)
    with open(out) as file:
        rows = [json.loads(line) for line in file]
    return {names[r["frame"]]: np.array([b[:5] for b in r["boxes"]], np.float32).reshape(-1, 5)
            for r in rows}


def sheet(pictures, found, rng, count=144):
    """Tiles of boxes that are taught without a label, with their score."""
    taught = []
    for p in pictures:
        rows, truth = found.get(p.path, np.zeros((0, 5))), p.true_boxes()
        sure = rows[rows[:, 4] >= data.SURE]
        if len(truth) and len(sure):
            sure = sure[geometry.iou(sure[:, :4], truth).max(1) < 0.3]
        taught += [(p, row) for row in sure]
    print(f"{len(taught)} boxes are taught that nobody labelled")
    tiles = []
    for n in rng.permutation(len(taught))[:count]:
        p, row = taught[n]
        img, side = p.read(), max(row[2] - row[0], row[3] - row[1])
        middle, half = (row[:2] + row[2:4]) / 2, max(1.5 * side, 24)
        x0, y0 = (int(v) for v in np.maximum(middle - half, 0))
        part = img[y0:int(middle[1] + half), x0:int(middle[0] + half)]
        k = TILE / max(part.shape[:2])
        part = cv2.resize(part, None, fx=k, fy=k, interpolation=cv2.INTER_CUBIC)
        a, b = (row[:2] - [x0, y0]) * k, (row[2:4] - [x0, y0]) * k
        cv2.rectangle(part, tuple(int(v) for v in a), tuple(int(v) for v in b), (0, 255, 255), 1)
        tile = np.zeros((TILE, TILE, 3), np.uint8)
        tile[:part.shape[0], :part.shape[1]] = part[:TILE, :TILE]
        cv2.putText(tile, f"{len(tiles) + 1} {row[4]:.2f}", (2, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.4,
                    (0, 255, 0), 1, cv2.LINE_AA)
        tiles.append(tile)
    tiles += [np.zeros((TILE, TILE, 3), np.uint8)] * (-len(tiles) % COLUMNS)
    return np.vstack([np.hstack(tiles[i:i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)])


if __name__ == "__main__":
    main()
