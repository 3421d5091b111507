"""Pictures of what a model gets wrong: the frames with most errors, drawn on one sheet.

    python3 detector/train/failures.py --detections FILE.jsonl --images LIST --data DIR --out X.png
    python3 detector/train/failures.py --detections FILE.jsonl --recording DIR --out X.png

Green: found. Red: missed. Yellow: no label there. A vehicle is found where a box of at least
`--score` overlaps it by a half (`--overlap`).
"""

import argparse
import json
import os

import cv2
import numpy as np

import boxes as geometry
import data

FOUND, MISSED, WRONG = (60, 200, 60), (40, 40, 230), (0, 210, 240)
TILE = (640, 480)


def judged(truth, rows, overlap):
    """The labels that are found and the boxes without one, best boxes first."""
    found, wrong = np.zeros(len(truth), bool), []
    for row in sorted(rows, key=lambda r: -r[4]):
        shared = geometry.iou(np.array([row[:4]], np.float32), truth)[0] * ~found
        if len(truth) and shared.max() >= overlap:
            found[shared.argmax()] = True
        else:
            wrong.append(row)
    return found, wrong


def drawn(picture, found, wrong):
    img = picture.read()
    # Labels are in pixels of the stored file, as detections are; `read` undoes a squeeze.
    k = np.array([1, picture.true_height / picture.height] * 2) * TILE[0] / img.shape[1]
    img = cv2.resize(img, (TILE[0], round(img.shape[0] * TILE[0] / img.shape[1])))
    marks = [(b, FOUND if f else MISSED) for b, f in zip(picture.boxes, found)]
    for box, colour in marks + [(row[:4], WRONG) for row in wrong]:
        x0, y0, x1, y1 = (np.array(box) * k).round().astype(int)
        cv2.rectangle(img, (int(x0), int(y0)), (int(x1), int(y1)), colour, 1)
    label = f"{picture.group}: {int((~found).sum())} missed, {len(wrong)} without label"
    cv2.putText(img, label, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1,
                cv2.LINE_AA)
    sheet = np.zeros((TILE[1], TILE[0], 3), np.uint8)
    part = img[:TILE[1]]
    sheet[:len(part)] = part
    return sheet


def recording(folder):
    with open(os.path.join(folder, "truth.jsonl")) as file:
        return [data.street_picture(folder, row) for row in map(json.loads, file)
                if row["picture"] == "live"]


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--detections", required=True)
    args.add_argument("--images", help="list of pictures of the data sets")
    args.add_argument("--data", help="folder of the data sets")
    args.add_argument("--recording", help="a recording of the simulated street")
    args.add_argument("--out", required=True)
    args.add_argument("--score", type=float, default=0.35)
    args.add_argument("--overlap", type=float, default=0.5)
    args.add_argument("--sheet", type=int, default=4, help="pictures on the sheet")
    args = args.parse_args()
    if args.recording:
        pictures = recording(args.recording)
    else:
        with open(args.images) as file:
            chosen = set(file.read().split())
        pictures = [p for p in data.load_all(args.data) if p.path in chosen]
    with open(args.detections) as file:
        rows = {r["frame"]: r["boxes"] for r in map(json.loads, file)}
    worst = []
    for p in pictures:
        kept = [r for r in rows.get(p.name, []) if r[4] >= args.score]
        found, wrong = judged(p.boxes, kept, args.overlap)
        worst.append(((~found).sum() + len(wrong), p.group, p.name, p, found, wrong))
    worst.sort(key=lambda row: (-row[0], row[1], row[2]))
    # Each camera once, then the rest.
    seen = set()
    first = [row for row in worst if not (row[1] in seen or seen.add(row[1]))]
    order = (first + [row for row in worst if row not in first])[:args.sheet]
    tiles = [drawn(*row[3:]) for row in order]
    tiles += [np.zeros_like(tiles[0])] * (len(tiles) % 2)
    rows_of_two = [np.hstack(tiles[i:i + 2]) for i in range(0, len(tiles), 2)]
    if not cv2.imwrite(args.out, np.vstack(rows_of_two)):
        raise OSError(f"{args.out}: cannot be written")


if __name__ == "__main__":
    main()
