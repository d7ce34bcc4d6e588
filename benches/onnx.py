#!/usr/bin/env python3
"""Times exported graphs in ONNX Runtime; `cape eval speed` times the same in this library.

    pip install onnxruntime numpy
    cape model export runs/cape --onnx graphs && python3 benches/onnx.py graphs [--threads 2]

Prints the shortest of several times in milliseconds for batches of 1 and 16.
"""
import argparse, pathlib, time

import numpy as np
import onnxruntime

ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
ap.add_argument('graphs', type=pathlib.Path)
ap.add_argument('--threads', type=int, default=2)
ap.add_argument('--repeats', type=int, default=10)
a = ap.parse_args()

options = onnxruntime.SessionOptions()
options.intra_op_num_threads = a.threads
options.log_severity_level = 3
random = np.random.default_rng(1)
for path in sorted(a.graphs.glob('*.onnx')):
    session = onnxruntime.InferenceSession(path, options, providers=['CPUExecutionProvider'])
    for batch in (1, 16):
        feeds = {
            value.name: random.standard_normal([batch, *value.shape[1:]]).astype(np.float32)
            for value in session.get_inputs()
        }
        times = []
        for _ in range(a.repeats):
            start = time.perf_counter()
            session.run(None, feeds)
            times.append(1000 * (time.perf_counter() - start))
        print(f'{path.name:14} batch {batch:2}: {min(times):8.2f} ms')
