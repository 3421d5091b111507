"""A network in f32 as a fully int8 one: ONNX with QuantizeLinear and DequantizeLinear.

Owns where activations are rounded, which of them share a scale, and how scales are chosen.
Activations are u8 with a zero point, one scale a tensor; weights s8, one scale an output
channel; biases i32. What follows the last convolutions stays in f32.

Scales: the range that gives the least squared error on calibration pictures. Tensors that
are only moved about (shuffle, slice, pooling, enlarging) keep the scale of their source, and
the halves of a shuffle share one, so that moving never rounds. Before that the channels of each
tensor are brought to one reach (`equalise.py`).
"""

import os
import tempfile

import cv2
import numpy as np
import onnx
import onnxruntime as ort
from onnx import helper, numpy_helper

import boxes
from equalise import equalise

# Values kept of each activation and picture.
SAMPLES = 4000
# Operators whose output lies on the same steps as their input.
MOVERS = {"MaxPool", "Reshape", "Transpose", "Slice", "Split", "Resize"}


def folded(path):
    """The network without what ONNX Runtime computes from constants, with short names."""
    with tempfile.TemporaryDirectory() as folder:
        options = ort.SessionOptions()
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.optimized_model_filepath = os.path.join(folder, "folded.onnx")
        ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        model = onnx.load(options.optimized_model_filepath)
    graph = model.graph
    # ONNX Runtime sorts nodes again; `nanodet.carry` and readers want the order of execution.
    order = {node.name: i for i, node in enumerate(onnx.load(path).graph.node)}
    waiting = [onnx.NodeProto.FromString(node.SerializeToString()) for node in graph.node]
    waiting.sort(key=lambda node: order.get(node.name, -1))
    there = {i.name for i in graph.input} | {t.name for t in graph.initializer} | {""}
    del graph.node[:]
    while waiting:
        node = next(node for node in waiting if there.issuperset(node.input))
        waiting.remove(node)
        there.update(node.output)
        graph.node.append(node)
    del graph.value_info[:]
    keep = {i.name for i in graph.input} | {o.name for o in graph.output}
    short = {}
    for node in graph.node:
        node.name, node.doc_string = "", ""
        for names in (node.input, node.output):
            for i, name in enumerate(names):
                if name and name not in keep:
                    names[i] = short.setdefault(name, f"t{len(short)}")
    for tensor in graph.initializer:
        tensor.name = short.get(tensor.name, tensor.name)
    del model.opset_import[:]
    model.opset_import.append(helper.make_opsetid("", 13))
    onnx.checker.check_model(model)
    return model


class Plan:
    """The tensors that are rounded, and those that share a scale."""

    def __init__(self, graph):
        self.graph = graph
        self.constants = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
        self.readers = {}
        for node in graph.node:
            for name in node.input:
                self.readers.setdefault(name, []).append(node)
        # Nodes behind which there is no convolution stay in f32.
        before = set()
        for node in reversed(graph.node):
            inner = [n for n in node.input if n and n not in self.constants]
            if node.op_type == "Conv" or before & set(node.output):
                before |= set(inner)
        self.rounded = before
        self.parent = {}
        for node in graph.node:
            inputs = [n for n in node.input if n in self.rounded]
            outputs = [n for n in node.output if n in self.rounded]
            if not outputs:
                continue
            if node.op_type in MOVERS or (node.op_type == "Concat" and self.shuffled(node)):
                for name in inputs + outputs:
                    self.join(outputs[0], name)

    def shuffled(self, node):
        return any(n.op_type == "Reshape" for n in self.readers[node.output[0]])

    def find(self, name):
        while self.parent.get(name, name) != name:
            name = self.parent[name]
        return name

    def join(self, a, b):
        a, b = self.find(a), self.find(b)
        if a != b:
            self.parent[b] = a

    def before_activation(self, name):
        return all(n.op_type == "LeakyRelu" for n in self.readers.get(name, []))


def samples(model, plan, pictures, width, height):
    """Some values of each rounded tensor, over all pictures, and its extremes."""
    probe = onnx.ModelProto.FromString(model.SerializeToString())
    known = {i.name for i in probe.graph.input} | {o.name for o in probe.graph.output}
    names = sorted(n for n in plan.rounded if n not in known)
    probe.graph.output.extend(helper.make_empty_tensor_value_info(n) for n in names)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(probe.SerializeToString(), options,
                                   providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(20210320)
    entry = session.get_inputs()[0].name
    kept = {n: [] for n in [entry, *names]}
    for path in pictures:
        data = boxes.blob(boxes.letterbox(cv2.imread(path), width, height)[0])
        found = [data, *session.run(names, {entry: data})]
        for name, value in zip(kept, found):
            flat = value.ravel()
            picked = flat[rng.integers(0, flat.size, min(SAMPLES, flat.size))]
            kept[name].append(np.concatenate([picked, [flat.min(), flat.max()]]))
    return {n: np.concatenate(v) for n, v in kept.items()}


def steps(lo, hi):
    """Scale and zero point of u8 steps that hold lo..hi and 0 exactly."""
    lo, hi = min(lo, 0.0), max(hi, 0.0)
    scale = max((hi - lo) / 255, 1e-8)
    zero = int(np.clip(np.rint(-lo / scale), 0, 255))
    return np.float32(scale), np.uint8(zero)


def rounded(x, scale, zero):
    return (np.clip(np.rint(x / scale) + zero, 0, 255) - zero) * scale


def best_steps(x, bend=None):
    """The range with the least squared error; `bend` is what the error passes through."""
    bend = bend or (lambda v: v)
    truth = bend(x)
    best = None
    for top in np.linspace(0.3, 1.0, 15):
        for low in np.linspace(0.2, 1.0, 9):
            scale, zero = steps(x.min() * low, x.max() * top)
            error = np.square(bend(rounded(x, scale, zero)) - truth).sum()
            if best is None or error < best[0]:
                best = (error, scale, zero)
    return best[1:]


def leaky(x):
    return np.where(x < 0, x * 0.1, x)


def weight_steps(plan):
    """Scale of each output channel of each convolution's weights."""
    found = {}
    for node in plan.graph.node:
        if node.op_type == "Conv":
            weight = plan.constants[node.input[1]]
            reach = np.abs(weight.reshape(len(weight), -1)).max(1)
            found[node.input[1]] = (np.maximum(reach, 1e-8) / 127).astype(np.float32)
    return found


def rounded_weights(plan, steps):
    """Weights as whole steps, and biases as they are."""
    weights, biases = {}, {}
    for node in plan.graph.node:
        if node.op_type == "Conv":
            weight, bias = (plan.constants[n] for n in node.input[1:3])
            step = steps[node.input[1]].reshape((-1,) + (1,) * (weight.ndim - 1))
            weights[node.input[1]] = np.clip(np.rint(weight / step), -127, 127).astype(np.int8)
            biases[node.input[2]] = bias
    return weights, biases


def quantise(source, path, pictures, width, height, double=False, teach=None):
    """Writes the int8 form of the f32 network `source`, which is `folded`, to `path`.

    With `teach` (see `distil.py`) scales and weights learn that they are rounded; without, each
    weight takes the nearest step.

    Values are rounded behind activations. With `double` before them too, which ONNX Runtime
    needs to convolve in int8, and which costs accuracy (0.015 AP by day on validation cameras
    in place of 0.001).
    """
    model = onnx.load(source)
    graph = model.graph
    equalise(model, Plan(graph), pictures, width, height)
    plan = Plan(graph)
    values = samples(model, plan, pictures, width, height)
    groups = {}
    for name in plan.rounded:
        if not plan.before_activation(name):
            groups.setdefault(plan.find(name), []).append(name)
    scales = {}
    rng = np.random.default_rng(1)
    for root, names in groups.items():
        x = np.concatenate([values[n] for n in names])
        if len(x) > 400_000:
            x = np.concatenate([rng.choice(x, 400_000), [x.min(), x.max()]])
        found = best_steps(x)
        scales.update({n: found for n in names})
    if double:
        for name in plan.rounded:
            if plan.before_activation(name):
                scales[name] = best_steps(values[name], leaky)
    steps = weight_steps(plan)
    if teach:
        scales, weights, biases = teach(model, scales, steps, width, height)
    else:
        weights, biases = rounded_weights(plan, steps)
    write(model, plan, scales, steps, weights, biases)
    onnx.save(model, path)
    return scales


def write(model, plan, scales, steps, weights, biases):
    """Puts the rounding nodes, whole weights and biases into the graph."""
    graph = model.graph
    constants, nodes, done = {}, [], set()

    def constant(name, value):
        constants[name] = numpy_helper.from_array(np.asarray(value), name)
        return name

    def scale_names(name):
        # Equal scales are stored once.
        scale, zero = scales[name]
        key = np.float32(scale).tobytes().hex() + f"{int(zero):02x}"
        return [constant("s" + key[:8], np.float32(scale)), constant(f"z{int(zero)}", np.uint8(zero))]

    def round_off(name):
        if name in scales and name not in done:
            done.add(name)
            both = scale_names(name)
            nodes.append(helper.make_node("QuantizeLinear", [name, *both], [name + "q"]))
            nodes.append(helper.make_node("DequantizeLinear", [name + "q", *both], [name + "d"]))

    for entry in graph.input:
        round_off(entry.name)
    for node in graph.node:
        if node.op_type == "Conv":
            weight, scale = weights[node.input[1]], steps[node.input[1]]
            w = node.input[1]
            zero = constant(f"o{len(weight)}", np.zeros(len(weight), np.int8))
            both = [constant(w + "s", scale), zero]
            nodes.append(helper.make_node("DequantizeLinear", [constant(w + "q", weight), *both],
                                          [w + "d"], axis=0))
            b = node.input[2]
            total = scale * scales[node.input[0]][0]
            ints = np.rint(biases[b] / total.astype(np.float64))
            ints = np.clip(ints, -2**31, 2**31 - 1).astype(np.int32)
            zero = constant(f"p{len(weight)}", np.zeros(len(weight), np.int32))
            both = [constant(b + "s", total.astype(np.float32)), zero]
            nodes.append(helper.make_node("DequantizeLinear", [constant(b + "q", ints), *both],
                                          [b + "d"], axis=0))
            node.input[1], node.input[2] = w + "d", b + "d"
        for i, name in enumerate(node.input):
            if name in done:
                node.input[i] = name + "d"
            elif name in plan.constants:
                constants[name] = numpy_helper.from_array(plan.constants[name], name)
        nodes.append(node)
        for name in node.output:
            round_off(name)
    nodes = [onnx.NodeProto.FromString(n.SerializeToString()) for n in nodes]
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(constants.values())
    onnx.checker.check_model(model)
