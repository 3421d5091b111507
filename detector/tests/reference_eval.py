"""pycocotools on a truth.jsonl and a detections file; prints the figures that `eval` states.

    python3 reference_eval.py TRUTH.jsonl DETECTIONS.jsonl
"""

import contextlib
import io
import json
import sys

from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

truth = {}
for line in open(sys.argv[1]):
    row = json.loads(line)
    truth[row["frame"]] = row["vehicles"]
names = sorted(truth)
number = {name: i + 1 for i, name in enumerate(names)}
annotations, found = [], []
for name in names:
    for vehicle in truth[name]:
        x0, y0, x1, y1 = vehicle["box"]
        annotations.append({"id": len(annotations) + 1, "image_id": number[name], "category_id": 1,
                            "bbox": [x0, y0, x1 - x0, y1 - y0], "area": (x1 - x0) * (y1 - y0),
                            "iscrowd": int(vehicle.get("crowd", False))})
for line in open(sys.argv[2]):
    row = json.loads(line)
    for x0, y0, x1, y1, score, _ in row["boxes"]:
        found.append({"image_id": number[row["frame"]], "category_id": 1, "score": score,
                      "bbox": [x0, y0, x1 - x0, y1 - y0]})
with contextlib.redirect_stdout(io.StringIO()):
    coco = COCO()
    coco.dataset = {"info": {}, "images": [{"id": number[n]} for n in names],
                    "categories": [{"id": 1}], "annotations": annotations}
    coco.createIndex()
    run = COCOeval(coco, coco.loadRes(found), "bbox")
    run.evaluate()
    run.accumulate()


def mean(overlap, area):
    values = run.eval["precision"][overlap, :, 0, area, 2]
    return float(values.mean())


areas = ["all", "small", "medium", "large"]
print(json.dumps({name: {"ap50": mean(slice(0, 1), i), "ap50_95": mean(slice(0, 10), i),
                         "largest_recall": float(run.eval["recall"][0, 0, i, 2])}
                  for i, name in enumerate(areas)}))
