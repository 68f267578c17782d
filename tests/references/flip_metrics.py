"""Reference FLIP for tests/metrics.rs, from the flip-evaluator package (the paper's authors'). At its default viewing, and at
two other numbers of pixels per degree for some pairs.

Run: python tests/references/flip_metrics.py > tests/references/flip_metrics.json
"""
import importlib.metadata
import json

import numpy
from flip_evaluator import evaluate
from metrics_pairs import described

black = numpy.zeros((8, 8, 3), numpy.float32)
default = evaluate(black, black, "LDR")[2]["ppd"]
cases = []
for index, (case, a, b, mask) in enumerate(described()):
    for ppd in [None, 20.0, 90.5] if index % 4 == 0 else [None]:
        # A one-pixel-wide array must be contiguous.
        error, _, _ = evaluate(numpy.ascontiguousarray(a), numpy.ascontiguousarray(b), "LDR", inputsRGB=True, applyMagma=False,
                                  parameters={} if ppd is None else {"ppd": ppd})
        error = error[..., 0].astype(numpy.float64)
        values = {"pixels_per_degree": ppd, "flip": float(error.mean()), "largest": float(error.max())}
        if mask.any():
            values["flip_masked"] = float(error[mask].mean())
        cases.append(case | values)
print(json.dumps({"flip-evaluator": importlib.metadata.version("flip-evaluator"), "numpy": numpy.__version__,
                  "default_pixels_per_degree": default, "cases": cases}, indent=1))
