"""Rewrites a QDQ model for comparisons: the same net in two other forms.

Arguments: the model, where its form in floats goes, and where the form goes whose values are
rounded before activations too. The second is what ONNX Runtime needs to convolve in int8: it
leaves convolutions in floats where an activation stands between them and the rounding. It is
not written for a model that does not round.
"""

import sys

import numpy as np
import onnx
from onnx import helper, numpy_helper

model_path, float_path, early_path = sys.argv[1:]
model = onnx.load(model_path)
graph = model.graph
constants = {tensor.name: tensor for tensor in graph.initializer}
array = lambda name: numpy_helper.to_array(constants[name])
rounds = any(node.op_type == "QuantizeLinear" for node in graph.node)


def write(nodes, more, path):
    used = {name for node in nodes for name in node.input}
    tensors = [t for t in list(graph.initializer) + more if t.name in used]
    made = helper.make_graph(nodes, graph.name, graph.input, graph.output, tensors)
    out = helper.make_model(made, opset_imports=model.opset_import)
    out.ir_version = model.ir_version
    onnx.save(out, path)


def in_floats():
    same, nodes, more = {}, [], []
    for node in graph.node:
        if node.op_type in ("QuantizeLinear", "DequantizeLinear"):
            if node.input[0] not in constants:
                same[node.output[0]] = same.get(node.input[0], node.input[0])
                continue
            values, scale = array(node.input[0]), array(node.input[1])
            zero = array(node.input[2]) if len(node.input) > 2 else np.zeros_like(values.dtype.type(0))
            shape = [-1] + [1] * (values.ndim - 1) if scale.size > 1 else []
            whole = values.astype(np.float32) - zero.astype(np.float32).reshape(shape)
            made = (whole * scale.reshape(shape)).astype(np.float32)
            more.append(numpy_helper.from_array(made, node.output[0]))
            continue
        copy = onnx.NodeProto()
        copy.CopyFrom(node)
        for i, name in enumerate(node.input):
            copy.input[i] = same.get(name, name)
        nodes.append(copy)
    write(nodes, more, float_path)


def rounded_early():
    readers, makers = {}, {}
    for node in graph.node:
        for name in node.input:
            readers.setdefault(name, []).append(node)
        for name in node.output:
            makers[name] = node
    nodes, more = [], []
    for node in graph.node:
        behind = readers.get(node.output[0], []) if node.output else []
        made = node.input and makers.get(node.input[0])
        if (node.op_type == "LeakyRelu" and len(behind) == 1 and made and made.op_type == "Conv"
                and behind[0].op_type == "QuantizeLinear"):
            slope = next((a.f for a in node.attribute if a.name == "alpha"), 0.01)
            scale, zero = array(behind[0].input[1]), float(array(behind[0].input[2]))
            # Steps that hold everything that the steps behind the activation can come from.
            least, most = -zero * float(scale) / slope, (255 - zero) * float(scale)
            early = np.float32((most - least) / 255)
            start = node.input[0]
            more.append(numpy_helper.from_array(np.array(early), f"{start}.scale"))
            point = np.array(round(-least / float(early)), np.uint8)
            more.append(numpy_helper.from_array(point, f"{start}.zero"))
            pair = [f"{start}.scale", f"{start}.zero"]
            nodes.append(helper.make_node("QuantizeLinear", [start, *pair], [f"{start}.steps"]))
            nodes.append(
                helper.make_node("DequantizeLinear", [f"{start}.steps", *pair], [f"{start}.rounded"]))
            copy = onnx.NodeProto()
            copy.CopyFrom(node)
            copy.input[0] = f"{start}.rounded"
            node = copy
        nodes.append(node)
    write(nodes, more, early_path)


in_floats()
if rounds:
    rounded_early()
