"""Counts of a detections file against the audited frames, camera by camera.

Owns the count and its figures; the rule of the labels lies in `detector/data/audit/README.md`.

    python3 count_audit.py --detections FILE.jsonl [--role check] [--score 0.315]

Detections are what `verge detect`, `detect.py` and `audit_boxes.py` write, in pixels of the stored
picture. A box counts when its bottom-centre lies in the region. A box that fits a hidden vehicle
better than any other is left out, so that finding it is neither rewarded nor punished; with
`--hidden` hidden vehicles are vehicles like all others.

bias: counted over true, less 1. MAE: mean absolute error a frame. light: the bias over frames of
at most 3 vehicles. slope: least squares through the origin over frames of more than 12.
"""

import argparse
import glob
import os

import numpy as np

import boxes
from audit import inside, regions
from audit_boxes import AUDIT, rows_of

LIGHT_TRAFFIC, HEAVY_FROM = 3, 13
FITS = 0.3  # overlap over the union; labels of moving vehicles lie up to 3 px off


def load_audit(folder, role):
    rows = [r for f in sorted(glob.glob(os.path.join(folder, "*.jsonl"))) for r in rows_of(f)]
    return [r for r in rows if role in (None, r["role"])]


def load_detections(path, score):
    """Boxes by frame: by its whole path, or by its file name as `verge detect` writes it."""
    return {r["frame"]: [b for b in r["boxes"] if b[4] >= score] for r in rows_of(path)}


def fitted(found, vehicles):
    """For each box the number of the vehicle it fits best, or -1."""
    if not found or not vehicles:
        return [-1] * len(found)
    overlap = boxes.iou(np.array([b[:4] for b in found], float),
                        np.array([v[:4] for v in vehicles], float))
    return [int(row.argmax()) if row.max() >= FITS else -1 for row in overlap]


def count(row, found, polygons, hidden):
    """True, counted, vehicles without a box, boxes without a vehicle of their own."""
    found = [b for b in found if inside(polygons, b)]
    best = fitted(found, row["vehicles"])
    veiled = {n for n, v in enumerate(row["vehicles"]) if v[5] and not hidden}
    best = [b for b in best if b not in veiled]
    seen = {b for b in best if b >= 0}
    true = len(row["vehicles"]) - len(veiled)
    return true, len(best), true - len(seen), len(best) - len(seen)


def figures(counts):
    """One line of the table from rows of (true, counted, missed, false)."""
    table = np.array(counts, float).reshape(-1, 4)
    true, counted, missed, false = table.T
    slack = true <= LIGHT_TRAFFIC
    heavy = true >= HEAVY_FROM
    ratio = lambda a, b: a / b if b else np.nan
    return {"frames": len(true), "true": true.sum(), "counted": counted.sum(),
            "bias": 100 * (ratio(counted.sum(), true.sum()) - 1),
            "mae": ratio(np.abs(counted - true).sum(), len(true)),
            "missed": missed.sum(), "false": false.sum(),
            "light": 100 * (ratio(counted[slack].sum(), true[slack].sum()) - 1),
            "slope": ratio((true * counted)[heavy].sum(), (true * true)[heavy].sum())}


def line(name, f):
    number = lambda v, form: "-" if np.isnan(v) else form.format(v)
    return (f"{name:<24}{f['frames']:>7}{f['true']:>7.0f}{f['counted']:>8.0f}"
            f"{number(f['bias'], '{:+.1f}'):>8}{number(f['mae'], '{:.2f}'):>7}"
            f"{f['missed']:>8.0f}{f['false']:>7.0f}"
            f"{number(f['light'], '{:+.0f}'):>7}{number(f['slope'], '{:.2f}'):>7}")


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--detections", required=True)
    args.add_argument("--audit", default=AUDIT)
    args.add_argument("--role", choices=["audit", "check"], help="only these frames")
    args.add_argument("--score", type=float, default=0.0, help="leave out boxes below it")
    args.add_argument("--hidden", action="store_true", help="hidden vehicles are true ones too")
    args = args.parse_args()
    shapes, found = regions(), load_detections(args.detections, args.score)
    counts, absent = {}, []
    for row in load_audit(args.audit, args.role):
        name = row["frame"]
        key = name if name in found else os.path.basename(name)
        if key not in found:
            absent.append(name)
            continue
        polygons = shapes[row["region"]]["polygons"]
        got = count(row, found[key], polygons, args.hidden)
        counts.setdefault((row["camera"], row["light"]), []).append(got)
    if absent:
        # A frame without a line would read as an empty road.
        raise SystemExit(f"{args.detections}: no line for {len(absent)} audited frames, the first "
                         f"is {absent[0]}; an empty frame needs a line with no boxes")
    print(f"{'camera':<24} frames   true counted  bias %    MAE  missed  false  light  slope")
    biases = []
    for camera in sorted({c for c, _ in counts}):
        parts = {light: rows for (c, light), rows in counts.items() if c == camera}
        whole = figures([r for rows in parts.values() for r in rows])
        biases.append(abs(whole["bias"]))
        print(line(camera, whole))
        if len(parts) > 1:
            for light, rows in sorted(parts.items()):
                print(line("  " + light, figures(rows)))
    print(line("all", figures([r for rows in counts.values() for r in rows])))
    for light in sorted({light for _, light in counts}):
        rows = [r for (_, name), part in counts.items() if name == light for r in part]
        print(line("  " + light, figures(rows)))
    print(f"mean |camera bias| {np.nanmean(biases):.1f} % over {len(biases)} cameras")


if __name__ == "__main__":
    main()
