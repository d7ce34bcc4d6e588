"""Checks exported graphs by ONNX's checker and compares their results in ONNX Runtime with recorded ones.

Usage: onnxruntime_check.py DIR, with DIR/CASE/{decoder,encoder,smpl}.onnx and batch-N.npz beside them, of
which the arrays have the names of inputs and outputs.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime

# Of the norm of the expected array.
TOLERANCE = 1e-4
# Between examples of a batch: less would hide faults.
SMALLEST_DIFFERENCE = 0.01

options = onnxruntime.SessionOptions()
options.log_severity_level = 3
faults = []
for path in sorted(Path(sys.argv[1]).glob("*/*.onnx")):
    name = f"{path.parent.name}/{path.name}"
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    inferred = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True)
    without_shape = [
        value.name
        for value in inferred.graph.value_info
        if not value.type.tensor_type.HasField("shape")
    ]
    if without_shape:
        faults.append(f"{name}: no shape is inferred for {without_shape[:3]}")
    notes = {entry.key: entry.value for entry in model.metadata_props}
    if len(notes["pose_joints"].split(",")) != 24 or notes["units"] != "metres, radians":
        faults.append(f"{name}: metadata {notes}")
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    worst = 0.0
    for expected in sorted(path.parent.glob("batch-*.npz")):
        arrays = np.load(expected)
        feeds = {value.name: arrays[value.name] for value in session.get_inputs()}
        for value, found in zip(session.get_outputs(), session.run(None, feeds), strict=True):
            wanted = arrays[value.name]
            if found.shape != wanted.shape or found.dtype != np.float32:
                faults.append(f"{name} {value.name}: {found.shape} {found.dtype}")
                continue
            norm = np.linalg.norm(wanted)
            if len(wanted) > 1 and np.linalg.norm(wanted - wanted.mean(0)) < SMALLEST_DIFFERENCE * norm:
                faults.append(f"{name} {value.name} {expected.name}: the examples hardly differ")
            error = np.linalg.norm(found - wanted) / norm
            worst = max(worst, error)
            if not error <= TOLERANCE:
                faults.append(f"{name} {value.name} {expected.name}: error {error:.1e} of the norm")
    print(f"ok {name}: at most {worst:.1e} of the norm")
print("\n".join(faults))
sys.exit(bool(faults))
