"""Frames with their truth, the net's boxes on them, and what the choice among boxes knows of each.

Owns the sources of truth (audited frames, K109F's labels, recordings of the street), the net at any
input size, and the terms of the evidence that a box has by itself. The fit lies in `evidence.py`.
"""

import glob
import json
import os
import struct
import tomllib

import cv2
import numpy as np
import onnx
import onnxruntime
from onnx import numpy_helper

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.join(HERE, "..", "..")
MODEL = os.path.join(ROOT, "models", "verge_nanodet_640x480.onnx")
FLOOR, SAME, SURE = 0.12, 0.75, 0.45
SAME_THING = 0.7  # overlap with a box of an earlier frame from which it is the same thing again
MEAN = np.array([103.53, 116.28, 123.675], np.float32)
STD = np.array([57.375, 57.12, 58.395], np.float32)
# Terms of a box by itself, in the order of `Frame.alone`.
UNARY = ["bias", "score", "car_px", "large.class", "motorcycle.class", "car.size",
         "car.size_squared", "large.size", "large.size_squared", "motorcycle.size", "car.small",
         "empty"]


class Net:
    """A net at another input size: only the shapes in the file change."""

    def __init__(self, model, width, height):
        model = onnx.load(model)
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


def distinct(boxes, most, over=0):
    """Of boxes, best first, those that overlap no better one by more, over the union or (1) the smaller."""
    part = overlaps(boxes, boxes)[over]
    kept = []
    for i in range(len(boxes)):
        if not kept or part[i, kept].max() <= most:
            kept.append(i)
    return np.array(kept, int)


class Frame:
    """A frame with its true boxes; `region(u, v)` says which contacts lie in the lanes."""

    def __init__(self, path, camera, night, size, boxes, hidden, region, light="day", role="check"):
        self.path, self.camera, self.night, self.size = path, camera, night, size
        self.light, self.role = light, role
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


def audited(shared, work):
    """All audited frames; those of videos and squeezed pictures are written to `work` first."""
    folder = os.path.join(ROOT, "detector", "data", "audit")
    regions = json.load(open(os.path.join(folder, "regions.json")))
    for path in sorted(glob.glob(os.path.join(folder, "*.jsonl"))):
        for row in map(json.loads, open(path)):
            if row["camera"] == "k109f":
                continue  # from `vehicles.json`, with the lanes of its table
            (width, height), squeeze = regions[row["region"]]["size"], 1.0
            picture = os.path.join(shared, row["frame"])
            if row["camera"].startswith("topview") and width == height:
                squeeze = 9 / 16
            if squeeze < 1 or "#" in picture:
                picture = plain(shared, row["frame"], squeeze, work)
            tall = round(height * squeeze)
            shape = {"size": [width, tall],
                     "polygons": [[[u, v * squeeze] for u, v in polygon]
                                  for polygon in regions[row["region"]]["polygons"]]}
            boxes = [[v[0], v[1] * squeeze, v[2], v[3] * squeeze] for v in row["vehicles"]]
            yield Frame(picture, row["camera"], row["light"] != "day", (width, tall), boxes,
                        [v[5] for v in row["vehicles"]], polygons(shape), row["light"], row["role"])


def plain(shared, frame, squeeze, work):
    """A frame of a video, or a squeezed picture in its true shape, as a picture of its own."""
    path, _, number = frame.partition("#")
    out = os.path.join(work, f"{os.path.basename(path)}_{number}.png")
    if not os.path.exists(out):
        if number:
            video = cv2.VideoCapture(os.path.join(shared, path))
            video.set(cv2.CAP_PROP_POS_FRAMES, int(number))
            img = video.read()[1]
        else:
            img = cv2.imread(os.path.join(shared, path))
        size = img.shape[1], round(img.shape[0] * squeeze)
        cv2.imwrite(out, cv2.resize(img, size, interpolation=cv2.INTER_AREA))
    return out


def street(folder):
    """Recordings that `street.py` has made, a camera each."""
    for recording in sorted(glob.glob(os.path.join(folder, "*", "truth.jsonl"))):
        home = os.path.dirname(recording)
        lanes = json.load(open(os.path.join(home, "lanes.json")))
        shape = {"size": [lanes["imageWidth"], lanes["imageHeight"]],
                 "polygons": [lane["points"] for lane in lanes["shapes"]]}
        region = polygons(shape)
        for row in map(json.loads, open(recording)):
            boxes = [v["box"] for v in row["vehicles"]]
            yield Frame(os.path.join(home, "frames", row["frame"]), os.path.basename(home), False,
                        shape["size"], boxes, [False] * len(boxes), region)


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


def cars(frames):
    """Boxes of a camera that surely show cars or vans, each thing once: `Sample` of `verge detect`."""
    found = np.zeros((0, 9))
    for frame in frames:
        best = frame.boxes[frame.boxes[:, 4:].max(1) >= SURE]
        best = best[distinct(best, 0.5, over=1)]
        best = best[best[:, 4:].argmax(1) <= 1]
        if len(found) and len(best):
            best = best[overlaps(best, found)[0].max(1) <= SAME_THING]
        found = np.concatenate([found, best])
    return found


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


def prepare(frames, columns, roads, model=MODEL):
    """Boxes and what is known of them, for inputs of so many columns; `None`: as the size of cars in the
    lanes asks for, by the steps of the shipped sidecar."""
    nets, groups = {}, {}
    for frame in frames:
        groups.setdefault(frame.camera, []).append(frame)
    with open(MODEL.replace(".onnx", ".toml"), "rb") as file:
        steps = tomllib.load(file)["step"]
    for group in groups.values():
        search(group, model, columns or steps[-2]["width_px"], nets)
        car = plane(cars(group), group[0].size[0])
        if columns is None:
            in_lanes = np.concatenate([frame.true[frame.inside(frame.true)] for frame in group])
            side = np.median(car(in_lanes)) / group[0].size[0]
            wide = next((s["width_px"] for s in steps if side * s["width_px"] >= s["car_px"]),
                        steps[-1]["width_px"])
            print(f"{group[0].camera}: cars of {640 * side:.0f} px in 640, input {wide}")
            if wide != steps[-2]["width_px"]:
                search(group, model, wide, nets)
                car = plane(cars(group), group[0].size[0])
        for frame in group:
            describe(frame, car, roads)


def search(frames, model, columns, nets):
    """The net's boxes on frames, with an input of so many columns."""
    for frame in frames:
        width, height = frame.size
        key = columns, int(-(-min(columns * 3 / 4, columns * height / width) // 32) * 32)
        net = nets.get(key) or nets.setdefault(key, Net(model, *key))
        img = cv2.imread(frame.path)
        frame.boxes = net.boxes(img)
        frame.boxes[:, :4] *= width / img.shape[1]
        frame.scale = min(key[0] / width, key[1] / height)


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
    frame.pairs, frame.queue = pairs(frame)
    frame.on_true = overlaps(boxes, frame.true)[0] if len(frame.true) else np.zeros((len(boxes), 0))
    frame.in_lanes = frame.inside(boxes)


def pairs(frame):
    """Terms of each box beside each other one, and whether both stand in one queue."""
    box, o = frame.boxes[:, :4], frame.smaller
    car = np.maximum(frame.car[:, None], frame.car)
    middle = (box[:, 0] + box[:, 2]) / 2
    beside = np.abs(middle[:, None] - middle)
    lower = (box[:, 3][:, None] - box[:, 3]) / car
    terms = np.stack([o, o * o, frame.union, o * np.minimum(beside / car, 1.5),
                      o * np.minimum(np.abs(lower), 1.5), o * np.maximum(-lower, 0)], 2)
    far = frame.size[0] / frame.car
    mean = (frame.car[:, None] + frame.car) / 2
    queue = (np.abs(far[:, None] - far) < 7) & (beside / mean < 1.5) & (o < 0.6)
    return terms.astype(np.float32), queue
