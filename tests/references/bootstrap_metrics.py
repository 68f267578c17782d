"""Reference intervals for tests/metrics.rs, from scipy.stats.bootstrap (percentile method, many resamples) and scipy.stats.t.

Run: python tests/references/bootstrap_metrics.py > tests/references/bootstrap_metrics.json
"""
import json

import numpy
import scipy
from metrics_pairs import generator

cases = []
for count, seed in [(2, 1), (3, 2), (8, 3), (20, 4), (23, 5), (60, 6)]:
    random = generator(seed)
    # Skewed, as decibels of sequences are not.
    values = numpy.array([20 + 10 * next(random) * next(random) for _ in range(count)])
    result = scipy.stats.bootstrap((values,), numpy.mean, n_resamples=200_000, method="percentile", rng=numpy.random.default_rng(0))
    low, high = result.confidence_interval
    t = scipy.stats.t.ppf(0.975, count - 1) / scipy.stats.norm.ppf(0.975)
    cases.append({"count": count, "seed": seed, "t": float(t), "mean": float(values.mean()), "low": float(low), "high": float(high)})
print(json.dumps({"scipy": scipy.__version__, "numpy": numpy.__version__, "cases": cases}, indent=1))
