"""Opens a frame with OpenEXR's own reader: names, types and header must be those of the channel table."""
import sys

import numpy
import OpenEXR

HALF, FLOAT, UINT = numpy.dtype("float16"), numpy.dtype("float32"), numpy.dtype("uint32")
EXPECTED = {name: HALF for name in [
    "R", "G", "B", "A", *(f"{layer}.{c}" for layer in ("raw", "albedo", "material", "guide_albedo") for c in "RGB"),
    *(f"{layer}.{c}" for layer in ("normal", "guide_normal") for c in "XYZ"),
    "motion.X", "motion.Y", "motion_prev.X", "motion_prev.Y"]}
EXPECTED.update({"depth.Z": FLOAT, "object_id.I": UINT, "material_id.I": UINT})
EXPECTED.update({f"variance.{c}": FLOAT for c in "RGB"})

with OpenEXR.File(sys.argv[1], separate_channels=True) as file:
    assert len(file.parts) == 1, "one part"
    header, channels = file.header(), file.channels()
    found = {name: channel.pixels.dtype for name, channel in channels.items()}
    missing = {n: t for n, t in EXPECTED.items() if found.get(n) != t}
    assert not missing, f"missing or of another type: {missing}, found {found}"
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION and header["type"] == OpenEXR.scanlineimage, header
    assert "name" not in header, "a layer name hides the passes in Blender"
    for key in ("renderflow/version", "renderflow/conventions", "renderflow/scene_hash", "worldToCamera", "chromaticities"):
        assert key in header, f"header lacks {key}"
    for name, channel in channels.items():
        assert not numpy.isnan(channel.pixels.astype("float64")).any(), f"NaN in {name}"
    for name in sorted(found):
        print(f"{name:16} {found[name]}")
print("OpenEXR", OpenEXR.__version__, "reads", sys.argv[1])
