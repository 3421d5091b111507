"""The table of the card: models side by side on cameras never trained on, with their spread.

    python3 detector/train/report.py --tool verge-detector --data DIR --fields DIR
        --found DIR MODEL MODEL ...

`--found` holds MODEL.DATASET.test.jsonl from detect.py; the first model is the base line.
Intervals: Student's t over cameras of the difference to the base line, 95 %.
"""

import argparse
import glob
import json
import os
import subprocess

import numpy as np

FOLDERS = {"sg_lta": "sg_lta/train", "atl_v2": "atl_v2", "topview": "topview_vehicle"}
# 97.5 % quantiles of Student's t by degrees of freedom.
STUDENT = {1: 12.706, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365}


def evaluate(args, dataset, model, frames):
    done = subprocess.run(
        [args.tool, "eval", "--json", "--truth", os.path.join(args.data, FOLDERS[dataset]),
         "--detections", os.path.join(args.found, f"{model}.{dataset}.{args.split}.jsonl"),
         "--ignore", os.path.join(args.fields, f"{dataset}.{args.split}.ignore.jsonl"),
         "--frames", frames], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)["all"]


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--tool", required=True)
    args.add_argument("--data", required=True)
    args.add_argument("--fields", required=True)
    args.add_argument("--found", required=True)
    args.add_argument("--split", default="test")
    args.add_argument("models", nargs="+")
    args = args.parse_args()
    print("| data set | light | pictures | vehicles | model | AP@0.5 | AP@0.5:0.95 "
          "| recall at precision 0.60 | per camera AP@0.5 | difference, 95 % |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for dataset in FOLDERS:
        for light in ("day", "night"):
            stem = os.path.join(args.fields, f"{dataset}.{args.split}.{light}")
            if not os.path.exists(stem + ".frames.txt"):
                continue
            base = None
            for model in args.models:
                whole = evaluate(args, dataset, model, stem + ".frames.txt")
                cameras = sorted(glob.glob(stem + ".*.frames.txt"))
                each = [evaluate(args, dataset, model, c)["ap50"] for c in cameras]
                base = each if base is None else base
                pairs = [a - b for a, b in zip(each, base) if a is not None]
                gap = ""
                if model != args.models[0] and len(pairs) > 2:
                    half = STUDENT[len(pairs) - 1] * np.std(pairs, ddof=1) / len(pairs) ** 0.5
                    gap = f"{np.mean(pairs):+.3f} ± {half:.3f}"
                spread = " ".join("-" if v is None else f"{v:.2f}" for v in each)
                print(f"| {dataset} | {light} | {whole['frames']} | {whole['vehicles']} | {model} "
                      f"| {whole['ap50']:.3f} | {whole['ap50_95']:.3f} "
                      f"| {whole['recall_at_precision']:.3f} | {spread} | {gap} |", flush=True)


if __name__ == "__main__":
    main()
