"""Writes distortion.csv: where OpenCV's cv2.projectPoints shows points, for lenses of several kinds.

pip install opencv-python-headless==5.0.0.93 numpy; python distortion.py
"""

import pathlib

import cv2
import numpy

# OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6.
LENSES = [
    [-0.28, 0.09, 0.0004, -0.0007, 0.0, 0.0, 0.0, 0.0],
    [0.12, -0.05, -0.002, 0.001, 0.01, 0.0, 0.0, 0.0],
    [0.4, 0.2, 0.0003, 0.0002, 0.05, 0.6, 0.3, 0.02],
    [-0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
]
rows = ["k1,k2,p1,p2,k3,k4,k5,k6,x,y,u,v"]
for lens in LENSES:
    for x, y in [(0.0, 0.0), (0.1, -0.05), (-0.4, 0.3), (0.55, 0.45), (-0.2, -0.6)]:
        shown, _ = cv2.projectPoints(
            numpy.array([[[x, y, 1.0]]]), numpy.zeros(3), numpy.zeros(3), numpy.eye(3), numpy.array(lens))
        rows.append(",".join(repr(float(v)) for v in [*lens, x, y, *shown[0, 0]]))
pathlib.Path(__file__).with_suffix(".csv").write_text("\n".join(rows) + "\n")
