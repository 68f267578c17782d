"""What OpenEXR's own reader sees in a frame file, as JSON.

    pip install OpenEXR==3.5.3
    cargo run --release -p renderflow-frame --example write_sample_frame -- sample.exr
    python openexr_read.py sample.exr > openexr_read.json
"""

import json
import sys

import numpy
import OpenEXR

TYPES = {"float16": "HALF", "float32": "FLOAT", "uint32": "UINT"}

with OpenEXR.File(sys.argv[1], separate_channels=True) as file:
    header, channels = file.header(), file.channels()
    json.dump(
        {
            "reader": f"OpenEXR {OpenEXR.__version__}",
            "parts": len(file.parts),
            "has_name": "name" in header,
            "compression": header["compression"].name,
            "lineOrder": header["lineOrder"].name,
            "channels": {name: TYPES[str(c.pixels.dtype)] for name, c in channels.items()},
            "pixel_7_5": {name: c.pixels[5, 7].item() for name, c in channels.items()},
            "worldToCamera": numpy.asarray(header["worldToCamera"]).ravel().tolist(),
            "worldToNDC": numpy.asarray(header["worldToNDC"]).ravel().tolist(),
            "attributes": {name: str(header[name]) for name in header if (name.startswith("renderflow/") and name != "renderflow/conventions") or name in ("spp", "colorInteropID", "chromaticities")},
        },
        sys.stdout,
        indent=1,
    )
    print()
