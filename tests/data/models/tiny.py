"""Writes tiny.onnx beside itself: a quantised net with each kind of operator that the kernels
know, made-up weights, for fuzzing."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

random = np.random.default_rng(1)
constants, nodes = [], []


def constant(name, values):
    constants.append(numpy_helper.from_array(np.asarray(values), name))
    return name


def add(op, inputs, output, **attributes):
    nodes.append(helper.make_node(op, inputs, [output], **attributes))
    return output


def rounded(x):
    pair = [constant(x + ".scale", np.float32(0.02)), constant(x + ".zero", np.uint8(114))]
    return add("DequantizeLinear", [add("QuantizeLinear", [x, *pair], x + ".q"), *pair], x + ".d")


def conv(x, name, inputs, outputs, kernel, stride, group=1):
    shape = (outputs, inputs // group, kernel, kernel)
    weights = [constant(name + ".w", random.integers(-127, 127, shape).astype(np.int8)),
               constant(name + ".scale_w", np.full(outputs, 0.003, np.float32)),
               constant(name + ".zero_w", np.zeros(outputs, np.int8))]
    weights = add("DequantizeLinear", weights, name + ".wd", axis=0)
    bias = constant(name + ".b", random.normal(0, 0.1, outputs).astype(np.float32))
    return add("Conv", [x, weights, bias], name, kernel_shape=[kernel] * 2, strides=[stride] * 2,
               pads=[kernel // 2] * 4, group=group)


def whole(name, *values):
    return constant(name, np.array(values, np.int64))


stem = add("LeakyRelu", [conv(rounded("images"), "stem", 3, 8, 3, 2)], "leaky", alpha=0.1)
pool = add("MaxPool", [rounded(stem)], "pool", kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4)
x = rounded(pool)
axis, start, middle, end = whole("axis", 1), whole("start", 0), whole("middle", 4), whole("end", 8)
left = add("Slice", [x, start, middle, axis], "left")
right = add("Slice", [x, middle, end, axis], "right")
deep = rounded(conv(right, "deep", 4, 4, 3, 1, 4))
joined = rounded(add("Concat", [left, deep], "joined", axis=1))
grouped = add("Reshape", [joined, whole("groups", 1, 2, 4, 8, 8)], "grouped")
turned = add("Transpose", [grouped], "turned", perm=[0, 2, 1, 3, 4])
shuffled = add("Reshape", [turned, whole("flat", 1, 8, 8, 8)], "shuffled")
scores = add("Sigmoid", [conv(shuffled, "last", 8, 8, 1, 1)], "scores")
cells = add("Reshape", [scores, whole("cells", 1, 8, -1)], "columns")
add("Transpose", [cells], "output", perm=[0, 2, 1])
graph = helper.make_graph(
    nodes, "tiny", [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 32, 32])],
    [helper.make_tensor_value_info("output", TensorProto.FLOAT, [1, 64, 8])], constants)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
model.ir_version, model.producer_name = 8, "verge"
onnx.checker.check_model(model)
onnx.save(model, Path(__file__).with_suffix(".onnx"))
