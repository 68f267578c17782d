"""Reference PSNR and SSIM for tests/metrics.rs, from scikit-image.

Run: python tests/references/skimage_metrics.py > tests/references/skimage_metrics.json
"""
import json
import warnings

import numpy
import skimage
from metrics_pairs import described
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

# PSNR of equal pictures divides by 0.
warnings.simplefilter("ignore")


def finite(value):
    """Not infinite in JSON: null."""
    return float(value) if numpy.isfinite(value) else None


cases = []
for case, a, b, mask in described():
    a, b = a.astype(numpy.float64), b.astype(numpy.float64)
    case["psnr"] = finite(peak_signal_noise_ratio(a, b, data_range=1.0))
    if mask.any():
        case["psnr_masked"] = finite(peak_signal_noise_ratio(a[mask], b[mask], data_range=1.0))
    if min(mask.shape) >= 11:
        mean, full = structural_similarity(a, b, data_range=1.0, channel_axis=2, gaussian_weights=True, sigma=1.5,
                                           use_sample_covariance=False, full=True)
        case["ssim"] = float(mean)
        inner = full.mean(2)[5:-5, 5:-5][mask[5:-5, 5:-5]]
        if inner.size:
            case["ssim_masked"] = float(inner.mean())
    cases.append(case)
print(json.dumps({"scikit-image": skimage.__version__, "numpy": numpy.__version__, "cases": cases}, indent=1))
