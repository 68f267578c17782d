#!/usr/bin/env python3
"""Reference values for tests/light_reference.rs: irradiance, prefiltered radiance and exposure of real skies by brute force
over every texel in float64, the environment BRDF by adaptive quadrature.

    pip install numpy scipy opencv-python-headless      (versions used: in the output)
    python light_ibl.py <folder of .hdr files> > light_ibl.json

Texels are constant over their solid angle; the map is turned by ROTATION about +Y (the sky turns by +ROTATION).
"""
import json
import pathlib
import sys

import cv2
import numpy as np
import scipy
from scipy.integrate import dblquad

MAPS = ["lebombo_1k.hdr", "immenstadter_horn_1k.hdr", "studio_small_03_1k.hdr"]
ROTATION = 0.7
LEVELS = 8


def directions(count):
    i = np.arange(count)
    y = 1 - 2 * (i + 0.5) / count
    phi = 2.399963229728653 * i
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(phi), y, r * np.sin(phi)], axis=1)


def texels(image):
    height, width, _ = image.shape
    phi = 2 * np.pi * (np.arange(width) + 0.5) / width
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    theta = np.pi * (np.arange(height) + 0.5) / height
    s, c = np.sin(theta)[:, None], np.cos(theta)[:, None]
    d = np.stack([np.sin(phi) * s, c + 0 * phi, -np.cos(phi) * s], axis=-1).reshape(-1, 3)
    omega = np.repeat((edges[:-1] - edges[1:]) * 2 * np.pi / width, width)
    co, si = np.cos(ROTATION), np.sin(ROTATION)
    turned = np.stack([co * d[:, 0] + si * d[:, 2], d[:, 1], -si * d[:, 0] + co * d[:, 2]], axis=1)
    return turned, omega


def brdf(nv, roughness):
    """Scale and bias of the split sum as an integral over light directions (cosine and azimuth)."""
    a = roughness**2
    v = np.array([np.sqrt(1 - nv * nv), 0.0, nv])
    lam = lambda c: 0.5 * (np.sqrt(1 + a * a * (1 / (c * c) - 1)) - 1)

    def term(phi, z, power):
        s = np.sqrt(max(0.0, 1 - z * z))
        h = np.array([s * np.cos(phi), s * np.sin(phi), z]) + v
        h /= np.linalg.norm(h)
        vh = float(h @ v)
        d = a * a / (np.pi * (h[2] ** 2 * (a * a - 1) + 1) ** 2)
        fresnel = (1 - vh) ** 5
        return 2 * d / (1 + lam(nv) + lam(z)) / (4 * nv) * (fresnel if power else 1 - fresnel)

    return [dblquad(term, 1e-9, 1, 0, np.pi, args=(k,), epsabs=1e-6, epsrel=1e-6)[0] for k in (0, 1)]


def main():
    out = {"versions": {"numpy": np.__version__, "scipy": scipy.__version__, "opencv": cv2.__version__}, "rotation": ROTATION}
    axes = directions(24)
    out["directions"] = axes.round(9).tolist()
    out["maps"] = {}
    for name in MAPS:
        image = cv2.imread(str(pathlib.Path(sys.argv[1]) / name), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)[..., ::-1].astype(np.float64)
        d, omega = texels(image)
        energy = image.reshape(-1, 3) * omega[:, None]
        irradiance, prefiltered = [], [[] for _ in range(LEVELS - 1)]
        for axis in axes:
            c = d @ axis
            irradiance.append((np.maximum(c, 0)[:, None] * energy).sum(0) / np.pi)
            for level in range(1, LEVELS):
                a2 = (level / (LEVELS - 1)) ** 4
                k = np.maximum(c, 0) / ((0.5 * (1 + c)) * (a2 - 1) + 1) ** 2
                prefiltered[level - 1].append((k[:, None] * energy).sum(0) / (k * omega).sum())
        up = (np.maximum(d[:, 1], 0)[:, None] * energy).sum(0) / np.pi
        out["maps"][name] = {
            "exposure": float(0.8 / (up @ [0.2126, 0.7152, 0.0722])),
            "irradiance": np.array(irradiance).round(6).tolist(),
            "prefiltered": np.array(prefiltered).round(6).tolist(),
        }
    out["brdf"] = [[nv, r, *brdf(nv, r)] for r in (0.3, 0.5, 0.75, 1.0) for nv in (0.1, 0.35, 0.7, 0.95)]
    json.dump(out, sys.stdout, separators=(",", ":"))


main()
