"""Reference PSNR and SSIM for tests/metrics.rs, from scikit-image.

Pictures come from a linear congruential generator that the test repeats, so only numbers are stored.
Run: python tests/references/skimage_metrics.py > tests/references/skimage_metrics.json
"""
import json

import numpy
import skimage
from skimage.metrics import peak_signal_noise_ratio, structural_similarity


def picture(width, height, seed, smooth):
    state = seed
    values = numpy.empty(width * height * 3)
    for i in range(values.size):
        state = (1664525 * state + 1013904223) % 2**32
        values[i] = (state >> 8) / 2**24
    values = values.reshape(height, width, 3)
    y, x = numpy.mgrid[0:height, 0:width]
    ramp = ((x * 3 + y * 5) % 64 / 64.0)[..., None]
    return (smooth * ramp + (1 - smooth) * values).astype(numpy.float32).astype(numpy.float64)


cases = []
for width, height, noise in [(11, 11, 0.5), (37, 23, 0.2), (64, 48, 0.05), (65, 33, 0.01), (128, 128, 0.3), (32, 200, 0.9)]:
    a = picture(width, height, 1, 1 - noise / 2)
    b = picture(width, height, 2, 1 - noise)
    cases.append({
        "width": width, "height": height, "noise": noise,
        "psnr": peak_signal_noise_ratio(a, b, data_range=1.0),
        "ssim": structural_similarity(a, b, data_range=1.0, channel_axis=2, gaussian_weights=True, sigma=1.5,
                                      use_sample_covariance=False),
    })
print(json.dumps({"scikit-image": skimage.__version__, "numpy": numpy.__version__, "cases": cases}, indent=1))
