"""Directional albedo of the GGX lobe, by integrating the BRDF over outgoing directions (not over visible normals, as the renderer
does). Writes ggx_albedo.csv: alpha, cosine, albedo at Fresnel reflectance 1, albedo weighted by (1 - cos)^5, and albedo of dielectrics
of the indices of refraction 1.5, 1.33 and 1.1.

    pip install numpy==2.4.6 scipy==1.17.1 && python ggx_albedo.py
"""

import pathlib

import numpy as np
from scipy import integrate


INDICES = (1.5, 1.33, 1.1)


def fresnel(cos, index):
    """Unpolarised reflectance from outside: Snell's law and Fresnel's two equations."""
    inside = np.sqrt(1 - (1 - cos * cos) / index**2)
    s = (cos - index * inside) / (cos + index * inside)
    p = (index * cos - inside) / (index * cos + inside)
    return (s * s + p * p) / 2


def integrand(theta, phi, alpha, wo, reflectance):
    """D G2 / (4 cos_o cos_i) cos_i sin theta for the half vector (theta, phi), times the Jacobian 4 (wo . h) of mirroring and a
    reflectance."""
    h = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    oh = wo @ h
    if oh <= 0:
        return 0.0
    wi = 2 * oh * h - wo
    if wi[2] <= 0:
        return 0.0
    d = alpha**2 / (np.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2)
    smith = lambda c: (-1 + np.sqrt(1 + alpha**2 * (1 - c * c) / (c * c))) / 2
    g2 = 1 / (1 + smith(wo[2]) + smith(wi[2]))
    value = d * g2 * oh / wo[2] * np.sin(theta)
    return value * reflectance(min(oh, 1.0))


def albedo(alpha, cos):
    wo = np.array([np.sqrt(1 - cos * cos), 0, cos])
    result = []
    # t in (0, 1) with theta = atan(alpha * t / (1 - t)) spreads the lobe evenly.
    def over(t, phi, reflectance):
        x = alpha * t / (1 - t)
        slope = alpha / (1 - t) ** 2 / (1 + x * x)
        return integrand(np.arctan(x), phi, alpha, wo, reflectance) * slope

    dielectrics = [lambda c, index=index: fresnel(c, index) for index in INDICES]
    for reflectance in (lambda c: 1.0, lambda c: (1 - c) ** 5, *dielectrics):
        value, _ = integrate.dblquad(over, 0, np.pi, 0, 1, args=(reflectance,), epsabs=3e-6, epsrel=3e-5)
        result.append(2 * value)
    return result


rows = ["alpha,cosine,e,b,glass,water,aerogel"]
for alpha in (0.0025, 0.02, 0.16, 0.36, 1.0):
    for cos in (0.03, 0.1, 0.4, 1.0):
        rows.append(",".join([f"{alpha},{cos}", *(f"{value:.6f}" for value in albedo(alpha, cos))]))
        print(rows[-1], flush=True)
pathlib.Path(__file__).with_suffix(".csv").write_text("\n".join(rows) + "\n")
