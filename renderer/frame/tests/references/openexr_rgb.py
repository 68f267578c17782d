"""Pixels of other people's files as OpenEXR's own reader sees them, as JSON: {file: {width, height, "x,y": [R, G, B]}}.

    pip install OpenEXR==3.5.3
    python openexr_rgb.py ASSETS/exr > openexr_rgb.json
"""

import json
import os
import sys

import OpenEXR

# Scan lines and tiles with levels; B44, ZIP and PXR24.
FILES = ["ScanLines/Cannon.exr", "MultiResolution/WavyLinesLatLong.exr", "TestImages/BrightRings.exr", "TestImages/RgbRampsDiagonal.exr"]

result = {}
for name in FILES:
    with OpenEXR.File(os.path.join(sys.argv[1], name), separate_channels=True) as file:
        rgb = [file.channels()[c].pixels for c in "RGB"]
        height, width = rgb[0].shape
        at = [(0, 0), (width - 1, 0), (width // 3, height // 2), (width // 2, height // 3), (width - 2, height - 3)]
        result[name] = {"width": width, "height": height, "compression": file.header()["compression"].name}
        result[name]["pixels"] = {f"{x},{y}": [float(c[y, x]) for c in rgb] for x, y in at}
json.dump(result, sys.stdout, indent=1)
print()
