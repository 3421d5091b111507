"""Writes the shipped model with an operator in its middle that the kernels do not know, and its
sidecar: `python3 tests/unknown_operator.py FOLDER`. What it costs, beside the net and the operator
itself, is the difference of `verge bench --model FOLDER/with.toml` and `--model
models/verge_nanodet_640x480.toml`; `net` in its output has the operator's own share. The net finds
nothing sensible any more.
"""

import hashlib
import pathlib
import sys

import onnx

ROOT = pathlib.Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "models/verge_nanodet_640x480.toml"
folder = pathlib.Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)

model = onnx.load(SHIPPED.with_suffix(".onnx"))
nodes = model.graph.node
# The convolution half-way, and the quantised activation that it reads.
convolutions = [at for at, node in enumerate(nodes) if node.op_type == "Conv"]
conv = nodes[convolutions[len(convolutions) // 2]]
source = next(node for node in nodes if conv.input[0] in node.output)
assert source.op_type == "DequantizeLinear", source.op_type
steps = list(source.input[1:])
added = [
    onnx.helper.make_node("Tanh", [conv.input[0]], ["unknown"]),
    onnx.helper.make_node("QuantizeLinear", ["unknown", *steps], ["unknown_q"]),
    onnx.helper.make_node("DequantizeLinear", ["unknown_q", *steps], ["unknown_d"]),
]
at = list(nodes).index(conv)
conv.input[0] = "unknown_d"
for place, node in enumerate(added):
    nodes.insert(at + place, node)
onnx.checker.check_model(model)
content = model.SerializeToString()
(folder / "with.onnx").write_bytes(content)
sidecar = []
for line in SHIPPED.read_text().splitlines():
    if line.startswith("file = "):
        line = 'file = "with.onnx"'
    if line.startswith("sha256 = "):
        line = f'sha256 = "{hashlib.sha256(content).hexdigest()}"'
    sidecar.append(line)
(folder / "with.toml").write_text("\n".join(sidecar) + "\n")
