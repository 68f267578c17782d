"""Relative errors by numpy, for the unit test of src/metrics/relmse.rs. Writes relmse.json beside this file."""
import json, pathlib
import numpy as np


def pictures(width, height):
    state = 7

    def random():
        nonlocal state
        state = (state * 1664525 + 1013904223) % 2**32
        return (state >> 8) / 2**24

    count = width * height
    reference = np.array([np.float32(2.0 * random() * random()) for _ in range(3 * count)], np.float32).reshape(count, 3)
    image = np.array([np.float32(float(v) * (0.5 + random())) for v in reference.ravel()], np.float32).reshape(count, 3)
    image[::97, 1] += np.float32(30)
    variance = np.array([np.float32(0.01 * random()) for _ in range(3 * count)], np.float32).reshape(count, 3)
    return [a.astype(np.float64) for a in (image, reference, variance)]


def relmse(image, reference, variance):
    error = ((image - reference) ** 2 / (reference**2 + 0.01)).mean(-1)
    noise = (variance / (reference**2 + 0.01)).mean(-1)
    order = np.argsort(error, kind="stable")
    kept = order[: int(len(order) * 0.99)]
    top = np.percentile(error, 99.9)
    return dict(
        mean=error.mean() - noise.mean(),
        trimmed=error[kept].mean() - noise[kept].mean(),
        clipped=np.minimum(error, top).mean() - noise.mean(),
        median=np.median(error),
    )


cases = []
for width, height in [(16, 16), (40, 25), (101, 67)]:
    for with_variance in (False, True):
        image, reference, variance = pictures(width, height)
        values = relmse(image, reference, variance * with_variance)
        cases.append(dict(width=width, height=height, with_variance=with_variance, relmse={k: float(v) for k, v in values.items()}))
path = pathlib.Path(__file__).with_suffix(".json")
path.write_text(json.dumps(cases, indent=1) + "\n")
