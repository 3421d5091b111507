"""A stand-in for the detector: an ONNX file of a few operators that finds nothing.

The box is about everything else, and emulation is slow; the shipped model was not tried there.
The file is written byte by byte (protobuf: https://protobuf.dev/programming-guides/encoding),
so that no package is needed. In: 1x3x64x64. Out: 1x4x6, a YOLOX head at stride 32, all 0.

    stand_in.py FOLDER
"""

import hashlib
import pathlib
import struct
import sys


def varint(n):
    out = bytearray()
    while n > 0x7F:
        out.append(n & 0x7F | 0x80)
        n >>= 7
    return bytes(out + bytes([n]))


def number(field, n):
    return varint(field << 3) + varint(n)


def text(field, value):
    value = value.encode() if isinstance(value, str) else value
    return varint(field << 3 | 2) + varint(len(value)) + value


def ints(name, values):
    body = text(1, name) + b"".join(number(8, v) for v in values) + number(20, 7)
    return text(5, body)


def integer(name, value):
    return text(5, text(1, name) + number(3, value) + number(20, 2))


def node(kind, inputs, output, *attributes):
    body = b"".join(text(1, i) for i in inputs) + text(2, output) + text(4, kind)
    return text(1, body + b"".join(attributes))


def tensor(name, shape, kind, data):
    return text(5, b"".join(number(1, n) for n in shape) + number(2, kind) + text(8, name) + text(9, data))


def value(field, name, shape):
    dims = b"".join(text(1, number(1, n)) for n in shape)
    return text(field, text(1, name) + text(2, text(1, number(1, 1) + text(2, dims))))


def model():
    graph = (
        node("AveragePool", ["images"], "pooled", ints("kernel_shape", [32, 32]), ints("strides", [32, 32]))
        + node("Concat", ["pooled", "pooled"], "six", integer("axis", 1))
        + node("Reshape", ["six", "shape"], "flat")
        + node("Transpose", ["flat"], "rows", ints("perm", [0, 2, 1]))
        + node("Mul", ["rows", "zero"], "output")
        + text(2, "stand-in")
        + tensor("shape", [3], 7, struct.pack("<3q", 1, 6, 4))
        + tensor("zero", [1], 1, struct.pack("<f", 0.0))
        + value(11, "images", [1, 3, 64, 64])
        + value(12, "output", [1, 4, 6])
    )
    return number(1, 8) + text(2, "verge") + text(7, graph) + text(8, text(1, "") + number(2, 13))


SIDECAR = """name = "stand_in"
file = "stand_in.onnx"
sha256 = "{sha256}"
licence = "Apache-2.0"
[input]
width_px = 64
height_px = 64
channels = "bgr"
mean = [0.0, 0.0, 0.0]
std = [1.0, 1.0, 1.0]
[head]
kind = "yolox"
strides = [32]
classes = 1
[[class]]
index = 0
name = "car"
[thresholds]
score = 0.5
iou = 0.6
"""

if __name__ == "__main__":
    folder, onnx = pathlib.Path(sys.argv[1]), model()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stand_in.onnx").write_bytes(onnx)
    (folder / "stand_in.toml").write_text(SIDECAR.format(sha256=hashlib.sha256(onnx).hexdigest()))
