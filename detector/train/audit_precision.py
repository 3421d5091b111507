"""AP@0.5 of detections against the audited frames, whose vehicles are all labelled.

    python3 audit_precision.py FILE.jsonl [FILE.jsonl ...] [--camera 1005 ...]

The data sets' own labels leave out about half of the vehicles in the lanes, so that AP by them judges
which vehicles somebody labelled. Detections are what `verge detect --score 0.02`, `detect.py` and
`audit_boxes.py --score 0.02` write. Boxes are taken best first; one is right when it overlaps by one half
a vehicle that no better one has. Hidden vehicles and boxes outside of the region count as neither. AP is
the mean of the best precision at 101 recalls, as COCO has it. Intervals: cameras drawn with
replacement, 90 %.
"""

import argparse
import os

import numpy as np

import boxes
from audit import inside, regions
from audit_boxes import AUDIT, rows_of
from count_audit import load_audit

NEED = 0.5
DRAWS, SEED = 1000, 20210320


def judged(row, found, polygons):
    """Score and rightness of the boxes that count, and how many vehicles there are."""
    true = np.array([v[:4] for v in row["vehicles"]], float).reshape(-1, 4)
    hidden = np.array([v[5] for v in row["vehicles"]], bool)
    free, out = np.ones(len(true)), []
    for box in sorted(found, key=lambda b: -b[4]):
        overlap = boxes.iou(np.array([box[:4]], float), true)[0] * free if len(true) else free
        seen = np.where(hidden, 0, overlap)
        best = seen if seen.max(initial=0) >= NEED else overlap
        if best.max(initial=0) >= NEED:
            free[best.argmax()] = 0
            if not hidden[best.argmax()]:
                out.append((box[4], 1.0))
        elif inside(polygons, box):
            out.append((box[4], 0.0))
    return out, int((~hidden).sum())


def average_precision(parts):
    """AP of frames that were judged."""
    rows = sorted((r for part, _ in parts for r in part), key=lambda r: -r[0])
    vehicles = sum(count for _, count in parts)
    if not rows or not vehicles:
        return np.nan
    right = np.cumsum([hit for _, hit in rows])
    precision = right / np.arange(1, len(rows) + 1)
    best = np.append(np.maximum.accumulate(precision[::-1])[::-1], 0)
    return best[np.searchsorted(right / vehicles, np.linspace(0, 1, 101))].mean()


def drawn(groups, rng):
    """Frames of as many cameras, drawn with replacement."""
    return [part for n in rng.integers(0, len(groups), len(groups)) for part in groups[n]]


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("detections", nargs="+")
    args.add_argument("--camera", action="append", help="only these [default: all]")
    args = args.parse_args()
    shapes, known = regions(), {}
    rows = [r for r in load_audit(AUDIT, None) if not args.camera or r["camera"] in args.camera]
    for path in args.detections:
        found = {r["frame"]: r["boxes"] for r in rows_of(path)}
        for row in rows:
            name = row["frame"] if row["frame"] in found else os.path.basename(row["frame"])
            if name not in found:
                raise SystemExit(f"{path}: no line for {row['frame']}")
            light = "day" if row["light"] == "day" else "night"
            got = judged(row, found[name], shapes[row["region"]]["polygons"])
            known.setdefault(light, {}).setdefault(row["camera"], {}).setdefault(path, []).append(got)
    for light, cameras in sorted(known.items()):
        for path in args.detections:
            groups = [camera[path] for camera in cameras.values()]
            first = [camera[args.detections[0]] for camera in cameras.values()]
            whole = average_precision([part for group in groups for part in group])
            gaps = [average_precision(drawn(groups, np.random.default_rng([SEED, n])))
                    - average_precision(drawn(first, np.random.default_rng([SEED, n])))
                    for n in range(DRAWS)]
            each = " ".join(f"{average_precision(group):.2f}" for group in groups)
            low, high = np.quantile(gaps, [0.05, 0.95])
            vehicles = sum(count for group in groups for _, count in group)
            print(f"{light:<6}{os.path.basename(path):<24}{vehicles:>5} vehicles  AP@0.5 {whole:.3f}  "
                  f"to the first {low:+.3f} to {high:+.3f}  by camera {each}")


if __name__ == "__main__":
    main()
