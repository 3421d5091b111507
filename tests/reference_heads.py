"""Tiny nets with random weights, one for each head, and their boxes by ONNX Runtime.

Arguments: a folder for the nets and sidecars, and the picture that is searched (PNG, of the
size of the input). Each net is described by NAME.onnx and NAME.toml; what must be found stands
in NAME.json, decoded here from ONNX Runtime's output as each head's authors describe it.
"""

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper
from PIL import Image

FOLDER, PICTURE = Path(sys.argv[1]), sys.argv[2]
WIDTH, HEIGHT, CLASSES, BINS, SCORE = 128, 64, 3, 8, 0.6
random = np.random.default_rng(7)
picture = np.asarray(Image.open(PICTURE).convert("RGB"), np.float32)
assert picture.shape == (HEIGHT, WIDTH, 3)
feed = ((picture - 114) / 60).transpose(2, 0, 1)[None].astype(np.float32)


class Net:
    """Nodes and constants that are put together."""

    def __init__(self):
        self.nodes, self.constants, self.count = [], [], 0

    def konst(self, values):
        self.count += 1
        name = f"c{self.count}"
        self.constants.append(numpy_helper.from_array(np.asarray(values), name))
        return name

    def add(self, op, *inputs, outputs=1, **attributes):
        self.count += 1
        names = [f"n{self.count}_{i}" for i in range(outputs)]
        self.nodes.append(helper.make_node(op, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def level(self, stride, channels):
        """Cells of one level straight from the picture."""
        weight = random.normal(0, 1.5 / stride, (channels, 3, stride, stride))
        bias = random.normal(0, 0.5, channels)
        height, width = -(-HEIGHT // stride) * stride - HEIGHT, -(-WIDTH // stride) * stride - WIDTH
        return self.add("Conv", "images", self.konst(weight.astype(np.float32)),
                        self.konst(bias.astype(np.float32)), kernel_shape=[stride] * 2,
                        strides=[stride] * 2, pads=[0, 0, height, width])

    def columns(self, raw, channels):
        return self.add("Reshape", raw, self.konst(np.array([1, channels, -1], np.int64)))

    def part(self, value, start, end, axis):
        whole = [self.konst(np.array([v], np.int64)) for v in (start, end, axis)]
        return self.add("Slice", value, *whole)


def grid(strides):
    cells = [(u, v, s) for s in strides for v in range(-(-HEIGHT // s)) for u in range(-(-WIDTH // s))]
    return np.array(cells, np.float32)


def save(name, net, outputs, head, external=False, half=False, dynamic=False):
    size = [1, 3, "h", "w"] if dynamic else [1, 3, HEIGHT, WIDTH]
    kind = TensorProto.FLOAT16 if half else TensorProto.FLOAT
    given = helper.make_tensor_value_info("images", kind, size)
    out = [helper.make_tensor_value_info(o, kind, None) for o in outputs]
    constants = net.constants
    if half:
        floats = lambda t: numpy_helper.to_array(t).dtype == np.float32
        constants = [numpy_helper.from_array(numpy_helper.to_array(t).astype(np.float16), t.name)
                     if floats(t) else t for t in constants]
    graph = helper.make_graph(net.nodes, name, [given], out, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 8
    path = FOLDER / f"{name}.onnx"
    more = {"save_as_external_data": True, "location": f"{name}.bin", "size_threshold": 200}
    onnx.save(model, path, **(more if external else {}))
    digest = hashlib.sha256(path.read_bytes()).hexdigest().upper()
    classes = "".join(f'[[class]]\nindex = {i}\nname = "{kind}"\n'
                      for i, kind in enumerate(["car", "van", "bus"]))
    (FOLDER / f"{name}.toml").write_text(f"""name = "{name}"
file = "{name}.onnx"
sha256 = "{digest}"
licence = "none"
{head}
[input]
width_px = {WIDTH}
height_px = {HEIGHT}
channels = "rgb"
mean = [114.0, 114.0, 114.0]
std = [60.0, 60.0, 60.0]
{classes}
[thresholds]
score = {SCORE}
iou = 1.0
""")
    session = ort.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    values = session.run(None, {"images": feed.astype(np.float16 if half else np.float32)})
    return [value.astype(np.float64) for value in values]


def found(name, boxes, scores, classes=None):
    """Writes the boxes whose best score counts, clipped to the picture."""
    best = scores.max(1) if classes is None else scores
    which = scores.argmax(1) if classes is None else classes
    rows = []
    for box, score, kind in zip(boxes, best, which):
        x0, y0, x1, y1 = box
        clipped = [max(x0, 0), max(y0, 0), min(x1, WIDTH), min(y1, HEIGHT)]
        if score >= SCORE and clipped[2] > clipped[0] and clipped[3] > clipped[1]:
            clipped = [min(max(v, 0), limit) for v, limit in
                       zip(box, (WIDTH, HEIGHT, WIDTH, HEIGHT))]
            rows.append([*map(float, clipped), float(score), int(kind)])
    (FOLDER / f"{name}.json").write_text(json.dumps(rows))


def corners(xywh):
    half = xywh[:, 2:] / 2
    return np.concatenate([xywh[:, :2] - half, xywh[:, :2] + half], 1)


def distances(logits, cells, centre):
    """Distribution focal loss: expectation over bins, in strides."""
    logits = logits.reshape(-1, 4, BINS)
    share = np.exp(logits - logits.max(-1, keepdims=True))
    sides = (share / share.sum(-1, keepdims=True) * np.arange(BINS)).sum(-1)
    point, stride = cells[:, :2] + centre, cells[:, 2:]
    return np.concatenate([point - sides[:, :2], point + sides[:, 2:]], 1) * stride


def nanodet(name, **form):
    net, strides = Net(), [8, 16, 32, 64]
    levels = []
    for stride in strides:
        raw = net.level(stride, CLASSES + 4 * BINS)
        scores = net.add("Sigmoid", net.part(raw, 0, CLASSES, 1))
        joined = net.add("Concat", scores, net.part(raw, CLASSES, CLASSES + 4 * BINS, 1), axis=1)
        levels.append(net.columns(joined, CLASSES + 4 * BINS))
    out = net.add("Transpose", net.add("Concat", *levels, axis=2), perm=[0, 2, 1])
    head = form.pop("head", 'head = "nanodet"')
    rows = save(name, net, [out], head, **form)[0][0]
    found(name, distances(rows[:, CLASSES:], grid(strides), 0), rows[:, :CLASSES])


def picodet():
    net, strides = Net(), [8, 16, 32, 64]
    raw = [net.level(stride, CLASSES + 4 * BINS) for stride in strides]
    turned = lambda value, count: net.add("Transpose", net.columns(value, count), perm=[0, 2, 1])
    scores = [turned(net.add("Sigmoid", net.part(r, 0, CLASSES, 1)), CLASSES) for r in raw]
    sides = [turned(net.part(r, CLASSES, CLASSES + 4 * BINS, 1), 4 * BINS) for r in raw]
    values = save("picodet", net, scores + sides, 'head = "picodet"')
    scores = np.concatenate([v[0] for v in values[:4]])
    sides = np.concatenate([v[0] for v in values[4:]])
    found("picodet", distances(sides, grid(strides), 0.5), scores)


def yolox_rows(net, strides):
    levels = []
    for stride in strides:
        raw = net.level(stride, 5 + CLASSES)
        scores = net.add("Sigmoid", net.part(raw, 4, 5 + CLASSES, 1))
        levels.append(net.columns(net.add("Concat", net.part(raw, 0, 4, 1), scores, axis=1), 5 + CLASSES))
    return net.add("Transpose", net.add("Concat", *levels, axis=2), perm=[0, 2, 1])


def decoded(net, rows, cells, columns):
    """Centre and size in pixels, then the other columns."""
    stride = net.konst(cells[None, :, 2:])
    centre = net.add("Mul", net.add("Add", net.part(rows, 0, 2, 2), net.konst(cells[None, :, :2])), stride)
    size = net.add("Mul", net.add("Exp", net.part(rows, 2, 4, 2)), stride)
    return centre, size, net.part(rows, 4, columns, 2)


def yolox():
    net, strides = Net(), [8, 16, 32]
    rows = save("yolox", net, [yolox_rows(net, strides)], 'head = "yolox"')[0][0]
    cells = grid(strides)
    centre = (rows[:, :2] + cells[:, :2]) * cells[:, 2:]
    boxes = corners(np.concatenate([centre, np.exp(rows[:, 2:4]) * cells[:, 2:]], 1))
    found("yolox", boxes, rows[:, 5:] * rows[:, 4:5])


def in_pixels(name, head):
    net, strides = Net(), [8, 16, 32]
    parts = decoded(net, yolox_rows(net, strides), grid(strides), 5 + CLASSES)
    out = net.add("Concat", *parts, axis=2)
    if name == "yolov5":
        out = net.add("Concat", out, out, out, axis=1)
    rows = save(name, net, [out], head)[0][0]
    found(name, corners(rows[:, :4]), rows[:, 5:] * rows[:, 4:5])


def yolov8():
    net, strides = Net(), [8, 16, 32]
    centre, size, scores = decoded(net, yolox_rows(net, strides), grid(strides), 5 + CLASSES)
    out = net.add("Concat", centre, size, net.part(scores, 1, 1 + CLASSES, 2), axis=2)
    out = net.add("Transpose", out, perm=[0, 2, 1])
    rows = save("yolov8", net, [out], 'head = "yolov8"')[0][0].T
    found("yolov8", corners(rows[:, :4]), rows[:, 4:])


def end2end():
    net, strides = Net(), [8, 16, 32]
    centre, size, scores = decoded(net, yolox_rows(net, strides), grid(strides), 5 + CLASSES)
    scores = net.part(scores, 1, 1 + CLASSES, 2)
    half = net.add("Mul", size, net.konst(np.float32(0.5)))
    best = net.add("ReduceMax", scores, axes=[2], keepdims=0)
    count = net.konst(np.array([20], np.int64))
    top, index = net.add("TopK", best, count, outputs=2, axis=1)
    kind = net.add("Cast", net.add("ArgMax", scores, axis=2, keepdims=1), to=TensorProto.FLOAT)
    all_ = net.add("Concat", net.add("Sub", centre, half), net.add("Add", centre, half),
                   net.add("Unsqueeze", best, net.konst(np.array([2], np.int64))), kind, axis=2)
    flat = net.add("Squeeze", index, net.konst(np.array([0], np.int64)))
    out = net.add("Gather", all_, flat, axis=1)
    rows = save("end2end", net, [out], 'head = "end2end"')[0][0]
    found("end2end", rows[:, :4], rows[:, 4], rows[:, 5].round().astype(int))


nanodet("nanodet")
nanodet("guessed", head="")
nanodet("external", external=True)
nanodet("dynamic", dynamic=True)
nanodet("half", half=True)
picodet()
yolox()
in_pixels("yolox_decoded", 'head = "yolox_decoded"')
in_pixels("yolov5", 'head = "yolov5"')
yolov8()
end2end()
