"""Times verge beside ONNX Runtime and OpenVINO: the shipped net in int8 and in floats, one thread,
640x480, processor time of one run. In turns, so that a busy machine slows all alike:

    python3 tests/runtimes.py PROGRAM [ROUNDS]

PROGRAM is a release build. Needs the packages numpy, onnx, onnxruntime and openvino. Random numbers
are the other runtimes' picture: no kernel's time follows its values. Prints the medians of rounds,
and the median and range of each round's ratios.
"""

import hashlib
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
import onnxruntime as ort
import openvino as ov

ROOT = pathlib.Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "models/verge_nanodet_640x480.toml"
RUNS = 15
program = sys.argv[1]
rounds = int(sys.argv[2]) if len(sys.argv) > 2 else 7
folder = pathlib.Path(tempfile.mkdtemp(prefix="verge-runtimes-"))


def sidecar(model):
    """Describes `model`, a form of the shipped one."""
    hashed = hashlib.sha256(model.read_bytes()).hexdigest()
    lines, known = [], False
    for line in SHIPPED.read_text().splitlines():
        # The boxes in the known picture are those of the int8 form.
        known = line == "[self_test]" or (known and not line.startswith("["))
        if known:
            continue
        line = f'file = "{model.name}"' if line.startswith("file = ") else line
        lines.append(f'sha256 = "{hashed}"' if line.startswith("sha256 = ") else line)
    model.with_suffix(".toml").write_text("\n".join(lines) + "\n")
    return model.with_suffix(".toml")


def median_ms(run):
    times = []
    for _ in range(RUNS + 3):
        begun = time.process_time()
        run()
        times.append((time.process_time() - begun) * 1e3)
    return statistics.median(times[3:])


def verge(model):
    command = [program, "bench", "--frames", ROOT / "tests/data/curve/frames",
               "--table", ROOT / "tests/data/curve.lut", "--model", model,
               "--input", "640x480", "--count", str(RUNS)]
    said = subprocess.run(command, check=True, capture_output=True, cwd=ROOT).stdout
    report = json.loads(said)
    return report["infer_ms"], report["frame_ms"]


def onnxruntime(path):
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    return lambda: session.run(None, {name: picture})


def openvino(path):
    one = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_NUM_THREADS": 1}
    request = ov.Core().compile_model(str(path), "CPU", one).create_infer_request()
    return lambda: request.infer([picture])


stored = SHIPPED.with_suffix(".onnx")
floats, early = folder / "float.onnx", folder / "early.onnx"
forms = ROOT / "src/daemon/commands/forms.py"
subprocess.run([sys.executable, forms, stored, floats, early], check=True)
picture = np.random.default_rng(1).normal(0, 1, (1, 3, 480, 640)).astype(np.float32)
theirs = {
    "ort int8, as stored": onnxruntime(stored),
    "ort int8, rounded early": onnxruntime(early),
    "ort f32": onnxruntime(floats),
    "openvino int8, as stored": openvino(stored),
    "openvino int8, rounded early": openvino(early),
}
ours = {"int8": SHIPPED, "f32": sidecar(floats)}
table = []
for _ in range(rounds):
    row = {name: median_ms(run) for name, run in theirs.items()}
    for name, model in ours.items():
        row[name], row[f"frame {name}"] = verge(model)
    row["ort int8"] = min(row["ort int8, as stored"], row["ort int8, rounded early"])
    row["openvino int8"] = min(row["openvino int8, as stored"], row["openvino int8, rounded early"])
    table.append(row)
    print(json.dumps({name: round(ms, 1) for name, ms in row.items()}), flush=True)
print(f"ONNX Runtime {ort.__version__}, OpenVINO {ov.__version__}, medians of {rounds} rounds:")
for name in table[0]:
    print(f"  {name}: {statistics.median(row[name] for row in table):.1f} ms")
for one, other in [("int8", "ort int8"), ("int8", "openvino int8"), ("f32", "ort f32"),
                   ("frame int8", "ort int8")]:
    ratios = sorted(row[one] / row[other] for row in table)
    print(f"  {one} / {other}: {statistics.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})")
