"""Fits the weights by which boxes are taken for vehicles, and counts the cameras left out of the fit.

    python3 detector/train/evidence.py --data DIR [--size 640 --size 800] [--cameras]

Truth: the audited frames (`detector/data/audit`), K109F's labels and the committed street recordings.
The choice is that of `src/evidence/mod.rs` and `src/scene/empty.rs`, written once more with numpy; here
the empty road is the median of all frames of a camera in one light. Prints the weights as the model's
sidecar has them, and bias and mean absolute error of each camera of sg_lta counted with weights that
were fitted without it.
"""

import argparse
import glob
import json
import os
import struct

import cv2
import numpy as np
import onnx
import onnxruntime
from onnx import numpy_helper
from scipy.optimize import minimize

import data

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.join(HERE, "..", "..")
MODEL = os.path.join(ROOT, "models", "verge_nanodet_640x480.onnx")
FLOOR, SAME, MATCH, SURE = 0.12, 0.75, 0.4, 0.45
MEAN = np.array([103.53, 116.28, 123.675], np.float32)
STD = np.array([57.375, 57.12, 58.395], np.float32)
UNARY = ["bias", "score", "car_px", "large.class", "motorcycle.class", "car.size",
         "car.size_squared", "large.size", "large.size_squared", "motorcycle.size", "car.small",
         "empty"]
PAIR = ["inside", "inside_squared", "overlap", "beside", "apart", "behind"]


class Net:
    """The shipped net at another input size: only the shapes in the file change."""

    def __init__(self, width, height):
        model = onnx.load(MODEL)
        sides = model.graph.input[0].type.tensor_type.shape.dim
        sides[2].dim_value, sides[3].dim_value = height, width
        del model.graph.output[0].type.tensor_type.shape.dim[:]
        del model.graph.value_info[:]
        for constant in model.graph.initializer:
            shape = numpy_helper.to_array(constant)
            if shape.dtype == np.int64 and len(shape) in (4, 5) and shape[0] == 1:
                stride = 480 // shape[-2]
                shape = np.array([*shape[:-2], -(-height // stride), -(-width // stride)])
                constant.CopyFrom(numpy_helper.from_array(shape, constant.name))
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"])
        self.width, self.height = width, height
        grids = []
        for stride in (8, 16, 32, 64):
            v, u = np.mgrid[0:-(-height // stride), 0:-(-width // stride)]
            grids.append(np.stack([u.ravel() * stride, v.ravel() * stride, np.full(u.size, stride)], 1))
        self.points = np.concatenate(grids).astype(np.float32)

    def boxes(self, img):
        """Candidates, best first: x0 y0 x1 y1 in pixels of `img` and five scores."""
        h, w = img.shape[:2]
        k = min(self.width / w, self.height / h)
        size = round(w * k), round(h * k)
        x, y = (self.width - size[0]) // 2, (self.height - size[1]) // 2
        canvas = np.full((self.height, self.width, 3), 114, np.float32)
        way = cv2.INTER_AREA if k < 1 else cv2.INTER_LINEAR
        canvas[y:y + size[1], x:x + size[0]] = cv2.resize(img, size, interpolation=way)
        planes = ((canvas - MEAN) / STD).transpose(2, 0, 1)[None].copy()
        out = self.session.run(None, {self.session.get_inputs()[0].name: planes})[0][0]
        best = out[:, :5].max(1)
        at = np.flatnonzero(best >= FLOOR)
        at = at[np.argsort(-best[at], kind="stable")][:1024]
        bins = out[at, 5:].reshape(-1, 4, 8)
        bins = np.exp(bins - bins.max(2, keepdims=True))
        sides = (bins * np.arange(8)).sum(2) / bins.sum(2) * self.points[at, 2:]
        u, v = self.points[at, 0], self.points[at, 1]
        found = np.stack([(u - sides[:, 0] - x) / k, (v - sides[:, 1] - y) / k,
                          (u + sides[:, 2] - x) / k, (v + sides[:, 3] - y) / k], 1)
        found[:, [0, 2]] = found[:, [0, 2]].clip(0, w)
        found[:, [1, 3]] = found[:, [1, 3]].clip(0, h)
        found = np.concatenate([found, out[at, :5]], 1)
        return found[distinct(found, SAME)]


def overlaps(a, b):
    """Intersection over union, and over the smaller."""
    low, high = np.maximum(a[:, None, :2], b[None, :, :2]), np.minimum(a[:, None, 2:4], b[None, :, 2:4])
    both = np.clip(high - low, 0, None).prod(2)
    area = [np.clip(q[:, 2:4] - q[:, :2], 0, None).prod(1) for q in (a, b)]
    union = area[0][:, None] + area[1][None] - both
    return both / np.maximum(union, 1e-9), both / np.maximum(np.minimum(area[0][:, None], area[1][None]), 1e-9)


def distinct(boxes, most):
    """Of boxes, best first, those that overlap no better one by more."""
    union, _ = overlaps(boxes, boxes)
    kept = []
    for i in range(len(boxes)):
        if not kept or union[i, kept].max() <= most:
            kept.append(i)
    return np.array(kept, int)


class Frame:
    """A frame with its true boxes; `region(u, v)` says which contacts lie in the lanes."""

    def __init__(self, path, camera, night, size, boxes, hidden, region):
        self.path, self.camera, self.night, self.size = path, camera, night, size
        self.true = np.array(boxes, float).reshape(-1, 4)
        self.hidden = np.array(hidden, bool)
        self.region = region
        self.vehicles = int((self.inside(self.true) & ~self.hidden).sum())

    def inside(self, boxes):
        if len(boxes) == 0:
            return np.zeros(0, bool)
        return self.region((boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 3])


def polygons(region):
    """Whether points lie in one of the polygons of an audited region."""
    width, height = region["size"]
    mask = np.zeros((height, width), np.uint8)
    for polygon in region["polygons"]:
        cv2.fillPoly(mask, [np.round(np.array(polygon)).astype(np.int32)], 1)
    return lambda u, v: mask[np.clip(v - 0.5, 0, height - 1).astype(int),
                             np.clip(u, 0, width - 1).astype(int)] > 0


def lanes(path):
    """Whether points lie in a lane of a table (`src/lane.rs`)."""
    table = open(path, "rb").read()
    at = 12 + struct.unpack("<H", table[10:12])[0]
    name = table[12]
    width, shift = 0, 13 + name
    sides = []
    for _ in range(2):
        value, bits = 0, 0
        while True:
            byte = table[shift]
            shift += 1
            value |= (byte & 127) << bits
            bits += 7
            if byte < 128:
                break
        sides.append(value)
    width, height = sides
    lane = np.frombuffer(table, np.uint8, width * height * 5, at)[::5].reshape(height, width)
    return lambda u, v: (v < height - 0.5) & (lane[np.clip(v, 0, height - 1).astype(int),
                                                   np.clip(u, 0, width - 1).astype(int)] > 0)


def audited(shared):
    folder = os.path.join(ROOT, "detector", "data", "audit")
    regions = json.load(open(os.path.join(folder, "regions.json")))
    for path in sorted(glob.glob(os.path.join(folder, "[0-9]*.jsonl"))):
        for row in map(json.loads, open(path)):
            region = regions[row["region"]]
            yield Frame(os.path.join(shared, row["frame"]), row["camera"], row["light"] != "day",
                        region["size"], [v[:4] for v in row["vehicles"]],
                        [v[5] for v in row["vehicles"]], polygons(region))


def committed(shared):
    tests = os.path.join(ROOT, "tests", "data")
    for row in json.load(open(f"{tests}/k109f/vehicles.json"))["frames"]:
        # The second and the third frame are the same picture.
        if row["frame"] != "vehicle_03.jpg":
            path = f"{shared}/k109f/camera_calibration/K109F/images/{row['frame']}"
            boxes = [v["box"] for v in row["vehicles"]]
            yield Frame(path, "k109f", False, (320, 240), boxes, [False] * len(boxes),
                        lanes(f"{tests}/k109f.lut"))
    for scene, size, each in (("curve", (320, 240), 2), ("freeway", (720, 480), 3)):
        for row in [json.loads(line) for line in open(f"{tests}/{scene}/truth.jsonl")][::each]:
            boxes = [v["box"] for v in row["vehicles"] if v["occlusion"] < 0.95]
            yield Frame(f"{tests}/{scene}/frames/{row['frame']}", scene, False, size, boxes,
                        [False] * len(boxes), lanes(f"{tests}/{scene}.lut"))


def plane(boxes, width):
    """The side of a car by place: `CarSize::fit`."""
    rows = np.stack([np.ones(len(boxes)), (boxes[:, 0] + boxes[:, 2]) / 2 / width - 0.5,
                     boxes[:, 3] / width], 1)
    side = np.sqrt(np.maximum((boxes[:, 2:4] - boxes[:, :2]).prod(1), 1)) / width
    weight = 1 / side
    for _ in range(40):
        a = rows * weight[:, None]
        fit = np.linalg.solve(a.T @ a + np.diag([1e-3, 0.015 * len(boxes), 1e-3]), a.T @ (side * weight))
        expected = np.maximum(rows @ fit, 4 / width)
        weight = 1 / expected / np.sqrt(1 + (np.log(side / expected) / 0.25) ** 2)
    return lambda b: width * np.maximum(fit[0] + fit[1] * ((b[:, 0] + b[:, 2]) / 2 / width - 0.5)
                                        + fit[2] * b[:, 3] / width, 4 / width)


def grid(path):
    img = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    k = min(1, 320 / max(img.shape))
    size = round(img.shape[1] * k), round(img.shape[0] * k)
    return cv2.resize(img, size, interpolation=cv2.INTER_AREA).astype(np.float32)


def field(luma):
    """The orientation field of `src/scene/field.rs`, 1 for an edge without doubt."""
    x, y = cv2.Sobel(luma, cv2.CV_32F, 1, 0), cv2.Sobel(luma, cv2.CV_32F, 0, 1)
    knee = max(3 * np.median(np.hypot(x, y)), 24) ** 2
    return np.stack([x * x - y * y, 2 * x * y], 2) / (x * x + y * y + knee)[..., None]


def likeness(here, road, boxes, k):
    out = []
    for x0, y0, x1, y1 in boxes * k:
        part = (slice(int(y0), max(int(np.ceil(y1)), int(y0) + 2)),
                slice(int(x0), max(int(np.ceil(x1)), int(x0) + 2)))
        a, b = here[part], road[part]
        noise = 1e-3 * a[..., 0].size
        out.append(max(0, (a * b).sum() / np.sqrt(((a * a).sum() + noise) * ((b * b).sum() + noise))))
    return np.array(out)


def prepare(frames, columns, roads):
    nets, groups = {}, {}
    for frame in frames:
        width, height = frame.size
        key = columns, int(-(-min(columns * 3 / 4, columns * height / width) // 32) * 32)
        net = nets.get(key) or nets.setdefault(key, Net(*key))
        img = cv2.imread(frame.path)
        frame.boxes = net.boxes(img)
        frame.boxes[:, :4] *= width / img.shape[1]
        frame.scale = min(key[0] / width, key[1] / height)
        groups.setdefault(frame.camera, []).append(frame)
    for group in groups.values():
        sure = []
        for frame in group:
            best = frame.boxes[frame.boxes[:, 4:].max(1) >= SURE]
            sure.append(best[distinct(best, 0.5)])
        car = plane(np.concatenate(sure), group[0].size[0])
        for frame in group:
            describe(frame, car, roads)


def describe(frame, car, roads):
    boxes = frame.boxes
    score, kind = boxes[:, 4:].max(1), boxes[:, 4:].argmax(1)
    frame.car = car(boxes)
    side = np.sqrt(np.maximum((boxes[:, 2:4] - boxes[:, :2]).prod(1), 1))
    r = np.clip(np.log(side / frame.car), -1.5, 1.5)
    road = roads.get((frame.camera, frame.night))
    like = np.zeros(len(boxes))
    if road is not None:
        here = field(grid(frame.path))
        like = likeness(here, road, boxes[:, :4], here.shape[1] / frame.size[0])
    is_car, large, motorcycle = kind <= 1, (kind == 2) | (kind == 3), kind == 4
    frame.alone = np.stack([
        np.ones(len(boxes)), np.clip(np.log(score / (1 - score)), -3, 3),
        np.clip(np.log(frame.car * frame.scale / 32), -1.5, 1.5), large, motorcycle,
        r * is_car, r * r * is_car, r * large, r * r * large, r * motorcycle,
        np.maximum(-r - 0.3, 0) ** 2 * is_car, like], 1)
    frame.union, frame.smaller = overlaps(boxes, boxes)
    frame.on_true = overlaps(boxes, frame.true)[0] if len(frame.true) else np.zeros((len(boxes), 0))
    frame.in_lanes = frame.inside(boxes)


def beside(frame, i, kept):
    if not kept:
        return np.zeros(len(PAIR))
    j = kept[int(frame.smaller[i, kept].argmax())]
    inside, car = frame.smaller[i, j], max(frame.car[i], frame.car[j])
    middle = frame.boxes[[i, j]][:, [0, 2]].mean(1)
    lower = (frame.boxes[i, 3] - frame.boxes[j, 3]) / car
    return np.array([inside, inside ** 2, frame.union[i, j],
                     inside * min(abs(middle[0] - middle[1]) / car, 1.5),
                     inside * min(abs(lower), 1.5), inside * max(-lower, 0)])


def choose(frame, weights, rows=None):
    """Boxes that count; `rows` gathers what the fit needs."""
    alone = frame.alone @ weights[:len(UNARY)]
    kept, taken = [], np.zeros(len(frame.true), bool)
    for i in np.argsort(-alone, kind="stable"):
        pair = beside(frame, i, kept)
        evidence = alone[i] + pair @ weights[len(UNARY):]
        free = np.where(taken, 0, frame.on_true[i])
        hit = free.size > 0 and free.max() >= MATCH
        if rows is not None and frame.in_lanes[i] and not (hit and frame.hidden[free.argmax()]):
            rows.append((np.concatenate([frame.alone[i], pair]), float(hit), frame.camera))
        if evidence >= 0:
            kept.append(i)
            if hit:
                taken[free.argmax()] = True
    return kept, int(frame.in_lanes[kept].sum()) - int((taken & frame.hidden).sum())


def fit(frames, weights, rounds=3):
    for _ in range(rounds):
        rows = []
        for frame in frames:
            choose(frame, weights, rows)
        x, y = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
        _, camera, count = np.unique([r[2] for r in rows], return_inverse=True, return_counts=True)
        share = count[camera] ** -0.5
        share /= share.mean()
        ridge = 0.02 * np.r_[0, 0.1, np.ones(len(weights) - 2)] / len(weights)

        def loss(w):
            t = x @ w
            slope = x.T @ (share * (1 / (1 + np.exp(-t)) - y)) / len(y) + 2 * ridge * w
            return (share * (np.logaddexp(0, t) - y * t)).mean() + (ridge * w * w).sum(), slope

        weights = minimize(loss, weights, jac=True, method="L-BFGS-B").x
    return weights


def report(frames, count, what):
    cameras, errors = {}, []
    for frame in frames:
        cameras.setdefault(frame.camera, []).append((frame.vehicles, count(frame)))
    for camera, counts in cameras.items():
        true, found = np.array(counts).T
        errors.append((found.sum() / true.sum() - 1, np.abs(found - true).mean()))
        print(f"{what} {camera}: {errors[-1][0] * 100:+.0f} %, error of a frame {errors[-1][1]:.2f}")
    bias, error = np.abs(np.array(errors)).mean(0)
    print(f"{what}: mean of absolute values {bias * 100:.1f} %, error of a frame {error:.2f}")


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--data", required=True)
    args.add_argument("--size", type=int, action="append", help="columns of the input")
    args = args.parse_args()
    pictures = {}
    for picture in data.load_sg_lta(args.data):
        pictures.setdefault((picture.group, picture.night), []).append(picture.path)
    roads, by_size = {}, {}
    for columns in args.size or [640, 800]:
        frames = list(audited(args.data))
        for key in {(f.camera, f.night) for f in frames} - roads.keys():
            if key in pictures:
                roads[key] = field(np.median([grid(path) for path in pictures[key]], axis=0))
        by_size[columns] = frames, frames + list(committed(args.data))
        prepare(by_size[columns][1], columns, roads)
    every = [frame for _, frames in by_size.values() for frame in frames]
    start = np.r_[2.4, 2.3, np.zeros(len(UNARY) - 2), 0, -1.4, -1.4, 0, 0, 0]
    weights = fit(every, start)
    for name, weight in zip(UNARY + PAIR, weights):
        print(f"{name} = {weight:.3f}")
    cameras = sorted({frame.camera for frame in by_size[(args.size or [640])[0]][0]})
    without = {c: fit([f for f in every if f.camera != c], weights, 1) for c in cameras}
    for columns, (frames, _) in by_size.items():
        report(frames, lambda f: choose(f, without[f.camera])[1], f"{columns} columns, fitted without")


if __name__ == "__main__":
    main()
