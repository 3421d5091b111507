"""Labels of unseen cameras, completed by eye inside a region of each camera.

Owns the choice of frames, the sheets to look at and the rows that come out; the rule lies in
`detector/data/audit/README.md`, the count in `count_audit.py`.

    python3 audit.py choose --data DIR --camera 1004 --frames 18 --list FILE --work DIR
    python3 audit.py sheets --data DIR --camera 1004 --work DIR
    python3 audit.py settle --camera 1004 --work DIR --decisions FILE

A frame is a path below the data folder; a frame of a video is `PATH#NUMBER`. `choose` cuts the
frames (in order of their names, which hold the time) into equal bins and draws as many from the
lighter as from the heavier half of each, so that light and load are spread; where a camera has
audited frames it draws among the others, and all of these are `check`. `sheets` draws the
numbered candidates: labels of the data set and what the shipped model finds at a low score at two
input sizes. `settle` reads what the eye decided, one line a frame:

    FRAME_NUMBER v:1,2,5-9 h:4 r:3=shadow,7=letters m:120,30,131,39,car;... c:5=truck

v vehicle, h vehicle hidden by more than the rule's limit, m and mh the same where no candidate
is, c another class, x a better box (x:5=120,30,131,39). All others are rejected: as what `r`
says, as `part` of a vehicle where they lie in one, as what stands at that place in every frame
(a line `* z:125,155,145,172=signal;...`), or else as `other`.
"""

import argparse
import json
import os
import random
import re

import cv2
import numpy as np

import boxes
import data
from audit_boxes import AUDIT, DATA, SHIPPED, detectors, read, rows_of, share
from audit_sheet import draw_sheet

SEED = 20210320
FLOOR = 0.15  # far below the shipped score: what could be a vehicle must be looked at
SAME = 0.5  # two candidates that overlap more are one
PART = 0.7  # a rejected box that lies so far in a vehicle is a part of it
AUDIT_FRAMES = 10
VEHICLE = ("v", "h")
# Singapore, 20 March 2021: civil dawn 06:48, sunrise 07:10, sunset 19:14, civil dusk 19:35.
# Street light rules outside of these, as `data.py` has it for the evening.
SG_LIGHT = [("06:48", "night"), ("07:12", "dusk"), ("19:00", "day"), ("19:20", "dusk")]


def audited(camera):
    """Rows of a camera that are settled."""
    path = os.path.join(AUDIT, f"{camera}.jsonl")
    return rows_of(path) if os.path.exists(path) else []


def regions():
    with open(os.path.join(AUDIT, "regions.json")) as file:
        return json.load(file)


def inside(polygons, box):
    """Whether the bottom-centre of a box lies in one of the polygons (on the edge counts)."""
    at = (float(box[0] + box[2]) / 2, float(box[3]))
    return any(cv2.pointPolygonTest(np.array(p, np.float32), at, False) >= 0 for p in polygons)



def light(frame, img):
    clock = re.search(r"sg_lta.*_(\d{2})(\d{2})\d{2}\.", frame)
    if not clock:
        return "night" if data.is_night(frame, "", img) else "day"
    now = f"{clock[1]}:{clock[2]}"
    return next((name for until, name in SG_LIGHT if now < until), "night")




def labels(root, frame, width, height):
    """The data set's own labels, as x0 y0 x1 y1 class."""
    stem = os.path.join(root, frame).replace("/images/", "/labels/").rsplit(".", 1)[0]
    names = {"sg_lta": data.SG_LTA, "atl_v2": data.ATL_V2, "topview_vehicle": data.TOPVIEW}
    names = names.get(frame.split("/")[0])
    if names is None or not os.path.exists(stem + ".txt"):
        return []
    found, kinds = data.read_yolo(stem + ".txt", width, height, names)
    return [[*map(float, b), data.CLASSES[k]] for b, k in zip(found, kinds)]


def candidates(nets, root, frame, polygons):
    """x0 y0 x1 y1 class score source, labels before boxes of the nets; score 0: no net saw it."""
    img = read(root, frame)
    height, width = img.shape[:2]
    kept = [[*b, 0.0, "label"] for b in labels(root, frame, width, height)]
    squeezed = frame.startswith("topview") and width == height
    true = round(width * 9 / 16) if squeezed else height
    if squeezed:
        img = cv2.resize(img, (width, true), interpolation=cv2.INTER_AREA)
    for net, source in zip(nets, ("640", "960")):
        rows = net.detect(img, FLOOR, SAME)
        rows[:, [1, 3]] *= height / true
        for row in rows[np.argsort(-rows[:, 4])]:
            near = [k for k in kept if boxes.iou(row[None, :4], np.array([k[:4]]))[0, 0] > SAME]
            for k in near:
                k[5] = max(k[5], float(row[4]))
            within = row[4] < SHIPPED and any(share(row, k) > 0.8 for k in kept)
            if not near and not within:
                kind = data.CLASSES[int(row[5]) + 1]
                kept.append([*map(float, row[:4]), kind, float(row[4]), source])
    kept = [k for k in kept if inside(polygons, k)]
    return sorted(([*(round(v, 1) for v in k[:4]), k[4], round(k[5], 3), k[6]] for k in kept),
                  key=lambda k: (k[3], k[0]))



def choose(args):
    shown = regions()[args.region or args.camera]
    with open(args.list) as file:
        frames = sorted(line.strip() for line in file if line.strip())
    # Load by the model's own count, only to spread the choice.
    net = detectors()[0]
    load = {}
    for frame in frames:
        rows = net.detect(read(args.data, frame), SHIPPED, 0.5)
        load[frame] = sum(inside(shown["polygons"], r) for r in rows)
    before = audited(args.camera)
    frames = [frame for frame in frames if frame not in {row["frame"] for row in before}]
    draw = random.Random(f"{SEED} {args.camera}" + " again" * bool(before))
    chosen = []
    for part in np.array_split(np.array(frames), max(1, args.frames // 2)):
        part = sorted(part, key=lambda f: (load[f], f))
        half = (len(part) + 1) // 2
        chosen += [str(draw.choice(p)) for p in (part[:half], part[half:]) if len(p)]
    audit = set() if before else set(draw.sample(chosen, min(AUDIT_FRAMES, len(chosen) // 2 + 1)))
    with open(os.path.join(args.work, f"{args.camera}.chosen.jsonl"), "w") as file:
        for frame in sorted(chosen):
            row = {"frame": frame, "camera": args.camera, "region": args.region or args.camera,
                   "light": light(frame, read(args.data, frame)),
                   "role": "audit" if frame in audit else "check"}
            file.write(json.dumps(row) + "\n")





def sheets(args):
    nets, polygons = detectors(), regions()
    out = []
    for number, row in enumerate(rows_of(os.path.join(args.work, f"{args.camera}.chosen.jsonl"))):
        shape = polygons[row["region"]]["polygons"]
        row["candidates"] = candidates(nets, args.data, row["frame"], shape)
        sheet = draw_sheet(read(args.data, row["frame"]), shape, row["candidates"])
        cv2.imwrite(os.path.join(args.work, f"{args.camera}_{number:02d}.png"), sheet)
        out.append(row)
    with open(os.path.join(args.work, f"{args.camera}.candidates.jsonl"), "w") as file:
        file.writelines(json.dumps(row) + "\n" for row in out)







def numbers(text):
    for part in text.split(","):
        first, _, last = part.partition("-")
        yield from range(int(first), int(last or first) + 1)


def places(lines):
    """Vehicles at fixed places, from the lines that begin with a star."""
    found = []
    for first, *words in lines:
        for item in words[0][2:].split(";") if first == "*" else []:
            box, _, kind = item.partition("=")
            found.append(([float(v) for v in box.split(",")], kind))
    return found


def decide(row, words, fixed=()):
    """Vehicles and rejected boxes of one frame from its line of decisions."""
    found = [list(c) for c in row["candidates"]]
    fate, missing = {}, []
    for word in words:
        key, _, text = word.partition(":")
        if key in ("v", "h"):
            fate.update({n: key for n in numbers(text)})
        elif key == "r":
            for item in text.split(","):
                which, _, kind = item.partition("=")
                fate.update({n: kind or "other" for n in numbers(which)})
        elif key in ("m", "mh"):
            for item in text.split(";"):
                *box, kind = item.split(",")
                missing.append([*map(float, box), kind, key == "mh"])
        elif key == "c":
            for item in text.split(","):
                found[int(item.split("=")[0]) - 1][4] = item.split("=")[1]
        elif key == "x":
            for item in text.split(";"):
                which, _, box = item.partition("=")
                found[int(which) - 1][:4] = [float(v) for v in box.split(",")]
        else:
            raise ValueError(f"{row['frame']}: {word}: not one of v h r m mh c x")
    odd = set(fate) - set(range(1, len(found) + 1))
    if odd:
        raise ValueError(f"{row['frame']}: no such candidates: {sorted(odd)}")
    vehicles = [[*f[:5], fate[n] == "h"] for n, f in enumerate(found, 1) if fate.get(n) in VEHICLE]
    vehicles += missing
    rejected = []
    for n, f in enumerate(found, 1):
        if fate.get(n) not in VEHICLE:
            part = "part" if any(share(f, v) > PART for v in vehicles) else None
            there = next((kind for box, kind in fixed if share(f, box) > PART), "other")
            rejected.append([*f[:4], fate.get(n) or part or there, f[5]])
    return sorted(vehicles, key=lambda v: (v[3], v[0])), rejected


def settle(args):
    rows = rows_of(os.path.join(args.work, f"{args.camera}.candidates.jsonl"))
    with open(args.decisions) as file:
        lines = [line.split() for line in file if line.strip() and line[0] != "#"]
    passes, polygons = json.loads(args.passes), regions()
    out = []
    fixed = places(lines)
    for first, *words in lines:
        if first == "*":
            continue
        row = rows[int(first)]
        vehicles, rejected = decide(row, words, fixed)
        # A region may have shrunk since the sheet was drawn.
        shape = polygons[row["region"]]["polygons"]
        vehicles = [v for v in vehicles if inside(shape, v)]
        rejected = [r for r in rejected if inside(shape, r)]
        out.append({k: row[k] for k in ("frame", "camera", "light", "role", "region")}
                   | {"vehicles": vehicles, "rejected": rejected,
                      "passes": passes.get(first, 1)})
    settled = {row["frame"] for row in out}
    whole = [row for row in audited(args.camera) if row["frame"] not in settled] + out
    with open(os.path.join(AUDIT, f"{args.camera}.jsonl"), "w") as file:
        file.writelines(json.dumps(row) + "\n" for row in sorted(whole, key=lambda r: r["frame"]))
    print(args.camera, len(out), "frames,", sum(len(r["vehicles"]) for r in out), "vehicles")


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("step", choices=["choose", "sheets", "settle"])
    args.add_argument("--data", default=DATA)
    args.add_argument("--camera")
    args.add_argument("--region", help="the camera's name when not given")
    args.add_argument("--work", help="folder of the sheets")
    args.add_argument("--list", help="frames to choose from, one a line")
    args.add_argument("--frames", type=int, default=18)
    args.add_argument("--decisions")
    args.add_argument("--passes", default="{}", help='looks at a frame, {"3": 2}; else 1')
    args = args.parse_args()
    {"choose": choose, "sheets": sheets, "settle": settle}[args.step](args)


if __name__ == "__main__":
    main()
