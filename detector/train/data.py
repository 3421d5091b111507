"""The labelled pictures: where they lie, how they are split by camera, what their labels say.

Owns the splits (whole cameras, whole scenes, whole videos), the class names and the
day/night rule. Knows nothing about the network or about augmentation.
"""

import glob
import json
import os
import re
from dataclasses import dataclass, field

import cv2
import numpy as np

import boxes as geometry

CLASSES = ["vehicle", "car", "van", "bus", "truck", "motorcycle"]
VEHICLE = 0

SURE = 0.45  # a teacher box above this is taught as a vehicle where the data set has no label
DOUBT = 0.12  # between this and SURE it is ignored

# Label number in each data set -> class here. `vehicle` says that the kind is not known.
SG_LTA = ["car", "truck", "van", "motorcycle", "bus"]
ATL_V2 = ["motorcycle", "bus", "car", "truck"]
TOPVIEW = ["vehicle"]

# sg_lta names carry the local time; street light rules from here on (sunset 19:14, 20 March).
SG_NIGHT_FROM_H = 19 + 20 / 60
# Elsewhere: mean luminance (Rec. 601, 0..255) of the upper third below this is night.
NIGHT_BELOW_LUMA = 70.0

# Scenes of atl_v2 that the brightness-blind clustering cuts in two; merged by eye.
ATL_SAME = {"s001": "s000", "s003": "s002", "s006": "s005",
            "s009": "s008", "s010": "s008", "s012": "s011", "s013": "s011", "s014": "s011"}
# One night freeway holds nearly all night pictures: whole in test, so atl_v2 night is unseen.
ATL_SPLIT = {"s002": "test", "s005": "test", "s008": "test", "s011": "val"}


@dataclass
class Picture:
    """One labelled picture; boxes are x0 y0 x1 y1 in pixels of the stored file."""

    path: str
    dataset: str
    group: str  # camera, scene or video: never on both sides of a split
    split: str  # train, val or test
    width: int
    height: int
    boxes: np.ndarray
    classes: np.ndarray
    night: bool = False
    # Stored pictures of topview_vehicle are squeezed to a square; this undoes it.
    true_height: int = 0
    far_unlabelled: bool = False
    teacher: np.ndarray = field(default_factory=lambda: np.zeros((0, 5), np.float32))

    @property
    def name(self):
        return os.path.basename(self.path)

    def read(self):
        """BGR pixels in the true aspect ratio."""
        img = cv2.imread(self.path, cv2.IMREAD_COLOR)
        if img is None:
            raise OSError(f"{self.path}: not a picture that OpenCV reads")
        if self.true_height != self.height:
            img = cv2.resize(img, (self.width, self.true_height), interpolation=cv2.INTER_AREA)
        return img

    def true_boxes(self):
        """Boxes in the pixels that `read` returns."""
        k = self.true_height / self.height
        return self.boxes * np.array([1, k, 1, k], np.float32)

    def targets(self):
        """Boxes, kinds and ignored boxes in the pixels that `read` returns: labels, and the teacher's
        boxes where the data set has none."""
        truth, kinds = self.true_boxes(), self.classes
        ignored = np.zeros((0, 4), np.float32)
        if self.far_unlabelled and len(self.teacher):
            free = np.ones(len(self.teacher), bool)
            if len(truth):
                free = geometry.iou(self.teacher[:, :4], truth).max(1) < 0.3
            sure = free & (self.teacher[:, 4] >= SURE)
            doubt = free & (self.teacher[:, 4] >= DOUBT) & ~sure
            ignored = self.teacher[doubt, :4]
            truth = np.concatenate([truth, self.teacher[sure, :4]])
            kinds = np.concatenate([kinds, np.zeros(sure.sum(), np.int64)])
        return truth.astype(np.float32), kinds, ignored.astype(np.float32)


def is_night(path, dataset, img):
    clock = re.search(r"_(\d{2})(\d{2})\d{2}\.", os.path.basename(path))
    if dataset == "sg_lta" and clock:
        return int(clock[1]) + int(clock[2]) / 60 >= SG_NIGHT_FROM_H
    return luma(img[: img.shape[0] // 3]) < NIGHT_BELOW_LUMA


def luma(img):
    """Mean Rec. 601 luminance of BGR pixels, 0..255."""
    b, g, r = (float(img[..., c].mean()) for c in range(3))
    return 0.114 * b + 0.587 * g + 0.299 * r


def read_yolo(path, width, height, names):
    boxes, classes = [], []
    with open(path) as file:
        for line in file:
            parts = line.split()
            if not parts:
                continue
            kind, cx, cy, w, h = int(parts[0]), *map(float, parts[1:5])
            boxes.append([(cx - w / 2) * width, (cy - h / 2) * height,
                          (cx + w / 2) * width, (cy + h / 2) * height])
            classes.append(CLASSES.index(names[kind]))
    return np.array(boxes, np.float32).reshape(-1, 4), np.array(classes, np.int64)


def thumbnail(img):
    small = cv2.resize(cv2.cvtColor(img, cv2.COLOR_BGR2GRAY), (16, 12), interpolation=cv2.INTER_AREA)
    small = small.astype(np.float32).ravel()
    return (small - small.mean()) / (small.std() + 1e-6)


def scene_clusters(thumbs, threshold=0.55):
    """Single-link clusters of pictures whose thumbnails correlate: one scene each."""
    thumbs = np.stack(thumbs)
    near = (thumbs @ thumbs.T / thumbs.shape[1]) > threshold
    label = -np.ones(len(thumbs), int)
    count = 0
    for seed in range(len(thumbs)):
        if label[seed] >= 0:
            continue
        stack = [seed]
        while stack:
            i = stack.pop()
            if label[i] >= 0:
                continue
            label[i] = count
            stack.extend(np.flatnonzero(near[i] & (label < 0)))
        count += 1
    return label


def split_by_rank(groups, weights=None):
    """Rank-based split, decided before any training: no group is chosen by its score.

    Sorted groups at rank 2, 6, 10, ... are test, at rank 1, 9, 17, ... validation.
    """
    split = {}
    for rank, group in enumerate(sorted(groups)):
        split[group] = "test" if rank % 4 == 2 else "val" if rank % 8 == 1 else "train"
    return split


def load_sg_lta(root):
    pictures = []
    files = sorted(glob.glob(os.path.join(root, "sg_lta", "train", "*.jpg")))
    for path in files:
        pictures.append((path, path[:-4] + ".txt", os.path.basename(path)[:4]))
    split = split_by_rank({p[2] for p in pictures})
    return [make(p, t, "sg_lta", g, split[g], SG_LTA, far=True) for p, t, g in pictures]


def load_topview(root):
    pictures = []
    for part in ("train", "valid"):
        for path in sorted(glob.glob(os.path.join(root, "topview_vehicle", part, "images", "*"))):
            video = re.match(r"([^-]*?)(_mp4|_png|_jpg|_jpeg|$)", os.path.basename(path)).group(1)
            label = path.replace("/images/", "/labels/").rsplit(".", 1)[0] + ".txt"
            pictures.append((path, label, video))
    split = split_by_rank({p[2] for p in pictures})
    return [make(p, t, "topview", g, split[g], TOPVIEW, far=True, aspect=9 / 16)
            for p, t, g in pictures]


def load_atl(root):
    files = sorted(glob.glob(os.path.join(root, "atl_v2", "images", "*")))
    scenes = scene_clusters([thumbnail(cv2.imread(f)) for f in files])
    names = [ATL_SAME.get(f"s{k:03d}", f"s{k:03d}") for k in scenes]
    split = {name: ATL_SPLIT.get(name, "train") for name in names}
    return [make(f, f.replace("/images/", "/labels/").rsplit(".", 1)[0] + ".txt",
                 "atl_v2", n, split[n], ATL_V2, far=True) for f, n in zip(files, names)]


def make(path, label, dataset, group, split, names, far=False, aspect=None):
    img = cv2.imread(path)
    height, width = img.shape[:2]
    boxes, classes = read_yolo(label, width, height, names)
    true_height = height if aspect is None else round(width * aspect)
    return Picture(path, dataset, group, split, width, height, boxes, classes,
                   is_night(path, dataset, img), true_height, far)


# Vehicles of the simulated street that are hidden further are ignored, not taught.
STREET_HIDDEN = 0.7


def load_street(root):
    """Recordings of `street.py`, all of them for training; `root` holds one folder for each.

    Data set `street`, so that a mix names its share. Vehicles that are mostly hidden come as
    teacher boxes without certainty: ignored.
    """
    found = []
    for path in sorted(glob.glob(os.path.join(root, "*", "truth.jsonl"))):
        folder = os.path.dirname(path)
        with open(path) as file:
            rows = [json.loads(line) for line in file]
        for row in rows:
            if row["picture"] == "live":
                found.append(street_picture(folder, row))
    return found


def street_picture(folder, row):
    path = os.path.join(folder, "frames", row["frame"])
    img = cv2.imread(path)
    height, width = img.shape[:2]
    seen = [v for v in row["vehicles"] if v["occlusion"] <= STREET_HIDDEN]
    hidden = [v for v in row["vehicles"] if v["occlusion"] > STREET_HIDDEN]
    boxes = np.array([v["box"] for v in seen], np.float32).reshape(-1, 4)
    kinds = np.array([CLASSES.index(v["class"]) for v in seen], np.int64)
    doubt = np.array([[*v["box"], 0.2] for v in hidden], np.float32).reshape(-1, 5)
    return Picture(path, "street", os.path.basename(folder), "train", width, height, boxes, kinds,
                   is_night(path, "street", img), height, True, doubt)


def load_all(root):
    return load_sg_lta(root) + load_atl(root) + load_topview(root)
