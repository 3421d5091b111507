"""Regions without labels, camera by camera, for `verge-detector eval --ignore`.

The labelled field of a camera (scene, video) is every cell of a 32 x 24 grid that any label of
any of its pictures touches. All other cells become ignore regions, one rectangle a run of
cells: an unmatched detection there may be a vehicle that nobody labelled. The field depends on
labels alone, so it is the same for every model.

    python3 detector/train/fields.py --data DIR --out DIR
"""

import argparse
import json
import os

import numpy as np

import data

COLUMNS, ROWS = 32, 24


def covered(pictures):
    cells = np.zeros((ROWS, COLUMNS), bool)
    for p in pictures:
        for x0, y0, x1, y1 in p.boxes / np.array([p.width, p.height] * 2):
            rows = slice(max(0, int(y0 * ROWS)), min(ROWS, int(np.ceil(y1 * ROWS))))
            columns = slice(max(0, int(x0 * COLUMNS)), min(COLUMNS, int(np.ceil(x1 * COLUMNS))))
            cells[rows, columns] = True
    return cells


def rectangles(cells, width, height):
    """The uncovered cells as runs along each row."""
    found = []
    for row in range(ROWS):
        start = None
        for column in range(COLUMNS + 1):
            free = column < COLUMNS and not cells[row, column]
            if free and start is None:
                start = column
            elif not free and start is not None:
                found.append([start * width / COLUMNS, row * height / ROWS,
                              column * width / COLUMNS, (row + 1) * height / ROWS])
                start = None
    return found


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--data", required=True)
    args.add_argument("--out", required=True)
    args = args.parse_args()
    os.makedirs(args.out, exist_ok=True)
    pictures = data.load_all(args.data)
    for dataset in sorted({p.dataset for p in pictures}):
        for split in ("val", "test"):
            chosen = [p for p in pictures if (p.dataset, p.split) == (dataset, split)]
            regions = os.path.join(args.out, f"{dataset}.{split}.ignore.jsonl")
            with open(regions, "w") as file:
                for group in sorted({p.group for p in chosen}):
                    members = [p for p in chosen if p.group == group]
                    cells = covered(members)
                    for p in members:
                        boxes = rectangles(cells, p.width, p.height)
                        file.write(json.dumps({"frame": p.name, "boxes": boxes}) + "\n")
            for light in ("day", "night"):
                for group in ["", *sorted({p.group for p in chosen})]:
                    names = [p.path for p in chosen if p.night == (light == "night")
                             and group in ("", p.group)]
                    if names:
                        label = f"{dataset}.{split}.{light}" + (f".{group}" if group else "")
                        with open(os.path.join(args.out, label + ".frames.txt"), "w") as file:
                            file.write("\n".join(names) + "\n")


if __name__ == "__main__":
    main()
