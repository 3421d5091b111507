"""Channels of one tensor brought to one reach, without a change of what the network computes.

Activations have one step for all channels of a tensor, so a channel that stays small is rounded
coarsely. LeakyReLU, pooling, enlarging and moving are homogeneous: a factor on a channel passes
through them, and a convolution behind takes it back (Nagel et al. 2019, "Data-Free Quantization
Through Weight Equalization and Bias Correction", section 4.1, with measured reach in place of
that of the weights). Owns which channels must keep one factor; `quantise.py` calls it.
"""

import cv2
import numpy as np
import onnx
import onnxruntime as ort
from onnx import helper, numpy_helper

import boxes

# Part of a channel's values, by size, that its reach holds; the rest may be cut off.
WITHIN = 0.9999
# Largest factor: beyond it a channel is as good as empty.
MOST = 32.0


class Channels:
    """Channels as numbered classes: those of one class are one value moved about, or are added."""

    def __init__(self, graph):
        self.constants = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
        self.parent, self.of, self.fixed = [], {}, set()
        for entry in graph.input:
            shape = [d.dim_value for d in entry.type.tensor_type.shape.dim]
            self.of[entry.name] = self.new(shape[1])
            self.fix(self.of[entry.name])
        for node in graph.node:
            self.follow(node)

    def new(self, count):
        first = len(self.parent)
        self.parent += range(first, first + count)
        return np.arange(first, first + count)

    def fix(self, channels):
        self.fixed.update(channels.ravel().tolist())

    def find(self, channel):
        while self.parent[channel] != channel:
            channel = self.parent[channel]
        return channel

    def follow(self, node):
        """Classes of a node's outputs. What is not homogeneous keeps its inputs as they are."""
        inputs = [self.of[name] for name in node.input if name in self.of]
        if not inputs:
            return
        first, constants, op = inputs[0], self.constants, node.op_type
        shape = constants.get(node.input[1]) if op == "Reshape" else None
        if op == "Conv":
            outputs = [self.new(len(constants[node.input[1]]))]
        elif op in ("LeakyRelu", "MaxPool", "Resize"):
            outputs = [first]
        elif op == "Concat" and len(inputs) == len(node.input) and all(i.ndim == 1 for i in inputs):
            outputs = [np.concatenate(inputs)]
        elif op == "Add" and len(inputs) == 2:
            for a, b in zip(*inputs):
                self.parent[self.find(b)] = self.find(a)
            outputs = [first]
        elif op == "Slice" and constants[node.input[3]].tolist() == [1]:
            start, end = (int(constants[node.input[i]][0]) for i in (1, 2))
            outputs = [first[start:min(end, len(first))]]
        elif op == "Split":
            outputs = np.split(first, len(node.output))
        # A shuffle: channels as rows and columns, turned, in a row again.
        elif shape is not None and len(shape) == 5 and first.ndim == 1:
            outputs = [first.reshape(shape[1:3])]
        elif op == "Transpose" and first.ndim == 2:
            outputs = [first.T]
        elif shape is not None and len(shape) == 4 and first.ndim == 2:
            outputs = [first.ravel()]
        else:
            for channels in inputs:
                self.fix(channels)
            return
        self.of.update(zip(node.output, outputs))


def reach(model, tensors, pictures, width, height):
    """Of each channel of each tensor, what `WITHIN` of its values do not exceed."""
    probe = onnx.ModelProto.FromString(model.SerializeToString())
    probe.graph.output.extend(helper.make_empty_tensor_value_info(t) for t in tensors)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(probe.SerializeToString(), options,
                                   providers=["CPUExecutionProvider"])
    found = dict.fromkeys(tensors, 0.0)
    for path in pictures:
        data = boxes.blob(boxes.letterbox(cv2.imread(path), width, height)[0])
        for name, value in zip(tensors, session.run(tensors, {session.get_inputs()[0].name: data})):
            size = np.abs(value[0].reshape(value.shape[1], -1))
            found[name] = np.maximum(found[name], np.quantile(size, WITHIN, axis=1))
    return found


def factors(channels, plan, found):
    """A factor for each class: its channels then reach as far as the widest on their scale."""
    widest = {}
    for name, value in found.items():
        root = plan.find(name)
        widest[root] = max(widest.get(root, 0.0), value.max())
    room = {}
    for name, value in found.items():
        for channel, own in zip(channels.of[name], value):
            room.setdefault(channels.find(channel), []).append(
                widest[plan.find(name)] / max(own, 1e-9))
    fixed = {channels.find(c) for c in channels.fixed}
    return {c: float(np.clip(min(r), 1.0, MOST)) for c, r in room.items() if c not in fixed}


def equalise(model, plan, pictures, width, height):
    """Changes the convolutions of `model`; `plan` says which tensors share a scale."""
    graph = model.graph
    channels = Channels(graph)
    entries = {e.name for e in graph.input}
    tensors = sorted(t for t in plan.rounded - entries if not plan.before_activation(t)
                     and t in channels.of and channels.of[t].ndim == 1)
    chosen = factors(channels, plan, reach(model, tensors, pictures, width, height))

    def factor(name):
        return np.array([chosen.get(channels.find(c), 1.0) for c in channels.of[name]])

    stored = {t.name: t for t in graph.initializer}
    for node in graph.node:
        if node.op_type != "Conv":
            continue
        weight, bias = (numpy_helper.to_array(stored[n]).astype(float) for n in node.input[1:3])
        before, behind = factor(node.input[0]), factor(node.output[0])
        groups = next((a.i for a in node.attribute if a.name == "group"), 1)
        # Depthwise: one input channel for each output channel. Else all of them for each.
        before = before.reshape((-1, 1, 1, 1) if groups > 1 else (1, -1, 1, 1))
        weight = weight / before * behind.reshape(-1, 1, 1, 1)
        for name, value in zip(node.input[1:3], (weight, bias * behind)):
            stored[name].CopyFrom(numpy_helper.from_array(value.astype(np.float32), name))
