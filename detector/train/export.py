"""A checkpoint as ONNX: f32, and what ships: fully int8 (QDQ) or with int8 weights only.

    python3 detector/train/export.py --checkpoint last.pt --out DIR --calibrate DATA_OR_LIST \
        --distil DATA_OR_LIST

With `--calibrate` the shipped file is fully int8 (see `quantise.py`), and with `--distil` it has
learned to be (see `distil.py`). Without it has int8 weights: symmetric, one scale an output
channel, turned back into f32 by Cast and Mul; activations stay f32. Also writes the sidecar that
the daemon reads.
"""

import argparse
import functools
import hashlib
import os

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

import data
import distil
import quantise
from nanodet import NanoDet, Scores

SIDECAR = """# {about}
# Card: README.md beside this file.
name = "{name}"
file = "{name}.onnx"
sha256 = "{digest}"
licence = "Apache-2.0"

[input]
width_px = {width}
height_px = {height}
channels = "bgr"
mean = [103.53, 116.28, 123.675]
std = [57.375, 57.12, 58.395]

[head]
kind = "nanodet-plus"
strides = [8, 16, 32, 64]
bins = 8
classes = 5

{classes}
[thresholds]
score = {score}
iou = {iou}
ios = {ios}
"""


def export_f32(net, path, width, height):
    torch.onnx.export(Scores(net).eval(), torch.zeros(1, 3, height, width), path,
                      input_names=["data"], output_names=["output"], opset_version=13,
                      do_constant_folding=True, dynamo=False)
    model = quantise.folded(path)
    onnx.save(model, path)
    return model


def int8_weights(model):
    """Convolution weights as int8 with a scale for each output channel."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    graph = model.graph
    kept, nodes = [], []
    weights = {n.input[1] for n in graph.node if n.op_type == "Conv"}
    for tensor in graph.initializer:
        if tensor.name not in weights:
            kept.append(tensor)
            continue
        value = numpy_helper.to_array(tensor)
        reach = np.abs(value.reshape(len(value), -1)).max(1)
        scale = np.maximum(reach, 1e-12).astype(np.float32) / 127
        shape = (-1,) + (1,) * (value.ndim - 1)
        steps = np.clip(np.rint(value / scale.reshape(shape)), -127, 127).astype(np.int8)
        kept.append(numpy_helper.from_array(steps, tensor.name + ".int8"))
        kept.append(numpy_helper.from_array(scale.reshape(shape), tensor.name + ".scale"))
        nodes.append(helper.make_node("Cast", [tensor.name + ".int8"], [tensor.name + ".steps"],
                                      to=TensorProto.FLOAT))
        nodes.append(helper.make_node("Mul", [tensor.name + ".steps", tensor.name + ".scale"],
                                      [tensor.name]))
    rest = list(graph.node)
    del graph.initializer[:], graph.node[:]
    graph.initializer.extend(kept)
    graph.node.extend(nodes + rest)
    # Names of inner values cost 60 kB and tell nothing.
    del graph.value_info[:]
    onnx.checker.check_model(model)
    return model


def training(where):
    """Paths in a list, or of all training pictures of the data sets in a folder."""
    if os.path.isfile(where):
        with open(where) as file:
            return [line.strip() for line in file if line.strip()]
    return sorted(p.path for p in data.load_all(where) if p.split == "train")


def calibration(where, count=60, seed=20210320):
    """Paths in a list, or as many training pictures of the data sets in a folder."""
    paths = training(where)
    if os.path.isfile(where):
        return paths
    return sorted(np.random.default_rng(seed).choice(paths, count, replace=False).tolist())


def sidecar(path, about, width, height, score, iou, ios):
    with open(path, "rb") as file:
        digest = hashlib.sha256(file.read()).hexdigest()
    names = ["car", "van", "bus", "truck", "motorcycle"]
    classes = "\n".join(f'[[class]]\nindex = {i}\nname = "{n}"\n' for i, n in enumerate(names))
    name = os.path.basename(path)[: -len(".onnx")]
    text = SIDECAR.format(about=about, name=name, digest=digest, width=width, height=height,
                          classes=classes, score=score, iou=iou, ios=ios)
    with open(path[: -len("onnx")] + "toml", "w") as file:
        file.write(text)


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--checkpoint", required=True)
    args.add_argument("--out", required=True)
    args.add_argument("--name", default="verge_nanodet")
    args.add_argument("--size", action="append", help="WIDTHxHEIGHT, may be repeated")
    args.add_argument("--weights", choices=["mean", "net"], default="mean")
    args.add_argument("--calibrate", help="folder of the data sets, or a list of training "
                      "pictures: fully int8")
    args.add_argument("--distil", metavar="DATA", help="the same: the int8 form then learns from "
                      "the f32 one on these pictures, which takes minutes")
    args.add_argument("--score", type=float, default=0.35)
    args.add_argument("--iou", type=float, default=0.5)
    args.add_argument("--ios", type=float, default=0.8, help="intersection over the smaller")
    args = args.parse_args()
    torch.set_num_threads(1)
    state = torch.load(args.checkpoint, map_location="cpu", weights_only=False)
    net = NanoDet()
    net.load_state_dict(state[args.weights])
    os.makedirs(args.out, exist_ok=True)
    about = f"verge's own detector: NanoDet-Plus-m, five kinds, step {state['step']}."
    for size in args.size or ["640x480"]:
        width, height = map(int, size.split("x"))
        stem = os.path.join(args.out, f"{args.name}_{size}")
        plain = export_f32(net, stem + ".f32.onnx", width, height)
        if args.calibrate:
            pictures = calibration(args.calibrate)
            teach = args.distil and functools.partial(
                distil.distil, pictures=training(args.distil))
            quantise.quantise(stem + ".f32.onnx", stem + ".onnx", pictures, width, height,
                              teach=teach)
        else:
            onnx.save(int8_weights(plain), stem + ".onnx")
        sidecar(stem + ".onnx", about, width, height, args.score, args.iou, args.ios)
        print(f"{stem}.onnx {os.path.getsize(stem + '.onnx')} bytes")


if __name__ == "__main__":
    main()
