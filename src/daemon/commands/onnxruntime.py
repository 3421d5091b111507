"""Times ONNX Runtime on request: `verge bench --compare-onnxruntime` runs this.

Arguments: the input as raw 32-bit floats, then model files. Says "ready" with the version;
for each number read, runs that model once on one thread and answers with the milliseconds of
processor time.
"""

import sys
import time

import numpy as np
import onnxruntime as ort

options = ort.SessionOptions()
options.intra_op_num_threads = 1
options.inter_op_num_threads = 1
options.log_severity_level = 3
sessions = [ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
            for path in sys.argv[2:]]
entry = sessions[0].get_inputs()[0]
feed = {entry.name: np.fromfile(sys.argv[1], np.float32).reshape(entry.shape)}
print("ready", ort.__version__, flush=True)
for line in sys.stdin:
    begun = time.process_time()
    sessions[int(line)].run(None, feed)
    print((time.process_time() - begun) * 1e3, flush=True)
