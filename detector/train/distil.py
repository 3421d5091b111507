"""The int8 form taught by the f32 one: weights that know they will be rounded.

Weights, in steps of their scale, biases, and the scales of activations learn by gradient descent
to give the logits that the f32 network gives, with every rounding in place and its gradient passed
straight through (Jacob et al. 2018, "Quantization and Training of Neural Networks for Efficient
Integer-Arithmetic-Only Inference", section 3). Zero points and the scales of weights stay as
`quantise.py` chose them. No label is read: the f32 network is the teacher on every picture.
"""

import cv2
import numpy as np
import onnx
import torch
import torch.nn.functional as F
from onnx import numpy_helper

import boxes

SEED = 20210320
# Pictures in all, and in one step.
PICTURES = 1200
BATCH = 2
# First change of a weight and of a bias: in steps of the weight's scale, and of the scale of the
# convolution's output (logits have `LOGIT` for one).
RATE = 0.006
LOGIT = 0.05
# The same for an activation's scale, in parts of itself.
RATE_SCALE = 3e-3
# Weight of a cell where the teacher sees nothing, and of a column of distances beside one of scores.
FLOOR = 0.01
DISTANCES = 0.25


def straight(rounded, x):
    """`rounded` in value, `x` in gradient."""
    return x + (rounded - x).detach()


def round_activation(x, scale, zero):
    """As QuantizeLinear and DequantizeLinear. The gradient of the scale is that of Esser et al.
    2020, "Learned Step Size Quantization", section 2.1."""
    steps = torch.clamp(x / scale, -zero, 255 - zero)
    return straight(torch.round(steps), steps) * scale


class Network(torch.nn.Module):
    """An ONNX graph as far as its last convolutions: in floats, or, with `scales` of activations
    and `steps` of weights, rounded."""

    def __init__(self, graph, constants, scales=None, steps=None):
        super().__init__()
        self.constants, self.scales = constants, {}
        # Tensors that share a scale share its parameter: the logarithm.
        self.logarithms = {}
        for name, shared in (scales or {}).items():
            if id(shared) not in self.logarithms:
                log = torch.tensor(np.log(float(shared[0])), dtype=torch.float32)
                self.logarithms[id(shared)] = torch.nn.Parameter(log)
            self.scales[name] = (self.logarithms[id(shared)], float(shared[1]))
        self.entry = graph.input[0].name
        last = max(i for i, node in enumerate(graph.node) if node.op_type == "Conv")
        self.nodes = list(graph.node)[: last + 1]
        read = {name for node in self.nodes for name in node.input}
        self.ends = [n.output[0] for n in self.nodes
                     if n.op_type == "Conv" and n.output[0] not in read]
        self.weights, self.biases, self.reach = {}, {}, {}
        for node in self.nodes:
            if node.op_type != "Conv":
                continue
            weight, bias = (torch.from_numpy(constants[n].astype(np.float32))
                            for n in node.input[1:3])
            if steps is not None:
                step = torch.from_numpy(steps[node.input[1]])
                step = step.reshape((-1,) + (1,) * (weight.ndim - 1))
                self.reach[node.input[1]] = step
                weight = weight / step
            self.weights[node.input[1]] = weight
            self.biases[node.input[2]] = bias
        if steps is not None:
            for values in (self.weights, self.biases):
                for name in values:
                    values[name] = torch.nn.Parameter(values[name])

    def weight(self, name):
        value = self.weights[name]
        if name in self.reach:
            held = torch.clamp(value, -127, 127)
            value = straight(torch.round(held), held) * self.reach[name]
        return value

    def forward(self, x):
        values = {self.entry: x}

        def keep(name, value):
            if name in self.scales:
                logarithm, zero = self.scales[name]
                value = round_activation(value, logarithm.exp(), zero)
            values[name] = value

        keep(self.entry, x)
        for node in self.nodes:
            inputs = [values[n] for n in node.input if n in values]
            fixed = [self.constants[n] for n in node.input if n in self.constants]
            outputs = self.run(node, inputs, fixed)
            for name, value in zip(node.output, outputs):
                keep(name, value)
        return [values[name] for name in self.ends]

    def run(self, node, inputs, fixed):
        x, op = inputs[0], node.op_type
        with_name = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
        if op == "Conv":
            pads = with_name.get("pads", [0, 0, 0, 0])
            return [F.conv2d(x, self.weight(node.input[1]), self.biases[node.input[2]],
                             with_name.get("strides", 1), pads[:2], 1, with_name.get("group", 1))]
        if op == "LeakyRelu":
            return [F.leaky_relu(x, with_name["alpha"])]
        if op == "MaxPool":
            return [F.max_pool2d(x, with_name["kernel_shape"], with_name["strides"],
                                 with_name["pads"][:2])]
        if op == "Reshape":
            return [x.reshape([len(x), *fixed[0].tolist()[1:]])]
        if op == "Transpose":
            return [x.permute(with_name["perm"])]
        if op == "Slice":
            start, end, axis = (int(f[0]) for f in fixed[:3])
            return [x.narrow(axis, start, min(end, x.shape[axis]) - start)]
        if op == "Concat":
            return [torch.cat(inputs, with_name["axis"])]
        if op == "Add":
            return [inputs[0] + inputs[1]]
        if op == "Resize":
            return [F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)]
        raise ValueError(f"{op} is not an operator of this network")


def picture(path, width, height, rng):
    """A training picture as the net sees it: zoomed, mirrored, and by another light."""
    image = cv2.imread(path)
    if rng.random() < 0.5:
        zoom = rng.uniform(0.5, 1.0)
        h, w = (max(1, int(side * zoom)) for side in image.shape[:2])
        y, x = (int(rng.integers(0, side - part + 1)) for side, part in zip(image.shape, (h, w)))
        image = image[y:y + h, x:x + w]
    if rng.random() < 0.5:
        image = image[:, ::-1]
    light = np.clip(image * rng.uniform(0.6, 1.3) + rng.uniform(-20, 20), 0, 255)
    return boxes.blob(boxes.letterbox(np.ascontiguousarray(light.astype(np.uint8)), width, height)[0])


def loss(found, wanted):
    """Squared difference of logits, by what the teacher sees in a cell."""
    total = 0.0
    for ours, theirs in zip(found, wanted):
        weight = torch.sigmoid(theirs[:, :1]) + FLOOR
        difference = (ours - theirs).square()
        scores, distances = difference[:, :6].mean(1, True), difference[:, 6:].mean(1, True)
        total = total + ((scores + DISTANCES * distances) * weight).sum()
    return total / len(found[0])


def distil(model, scales, steps, width, height, pictures):
    """Scales as learned, weights in steps (s8) and biases (float) of the folded `model`.

    `scales`: scale and zero point by tensor; those that share a pair go on sharing it. `steps`: a
    weight's scale for each output channel. `pictures`: paths of training pictures.
    """
    graph = model.graph
    constants = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
    torch.manual_seed(SEED)
    rng = np.random.default_rng(SEED)
    teacher = Network(graph, constants)
    student = Network(graph, constants, scales, steps)
    behind = {n.input[0]: n.output[0] for n in student.nodes if n.op_type == "LeakyRelu"}
    groups = [{"params": list(student.weights.values()), "lr": RATE},
              {"params": list(student.logarithms.values()), "lr": RATE_SCALE}]
    for node in student.nodes:
        if node.op_type == "Conv":
            out = behind.get(node.output[0], node.output[0])
            unit = float(scales[out][0]) if out in scales else LOGIT
            groups.append({"params": [student.biases[node.input[2]]], "lr": RATE * unit})
    optimiser = torch.optim.Adam(groups)
    count = PICTURES // BATCH
    fall = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda i: 0.5 * (1 + np.cos(np.pi * i / count)) * min(1, (i + 1) / 20))
    recent = []
    for i in range(count):
        chosen = rng.choice(pictures, BATCH)
        data = torch.from_numpy(
            np.concatenate([picture(p, width, height, rng) for p in chosen]))
        with torch.no_grad():
            wanted = teacher(data)
        error = loss(student(data), wanted)
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        fall.step()
        recent.append(error.item())
        if (i + 1) % 50 == 0:
            print(f"int8, step {i + 1} of {count}: loss {np.mean(recent[-50:]):.3f}", flush=True)
    with torch.no_grad():
        ints = {n: torch.clamp(torch.round(v), -127, 127).numpy().astype(np.int8)
                for n, v in student.weights.items()}
        learned = {n: (np.float32(log.exp().item()), np.uint8(zero))
                   for n, (log, zero) in student.scales.items()}
        return learned, ints, {n: v.numpy() for n, v in student.biases.items()}
