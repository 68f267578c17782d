"""Two pictures of one scene and their difference, side by side, as a PNG: ours, the other renderer's, and the relative difference
(ours / theirs - 1, red where ours is brighter, blue where darker, full colour at 5 %).

Our pictures come from the tests: RENDERFLOW_TEST_PICTURES=FOLDER cargo test --release --test published; the others' from
mitsuba_published.py with a folder as its second argument. The difference is averaged over 4x4 pixels, so that it shows more than noise.
Run: python tests/references/compare.py OURS.exr THEIRS.exr OUT.png [MORE_OURS.exr MORE_THEIRS.exr ...]     (needs mitsuba and numpy)
"""
import sys

import mitsuba
import numpy

mitsuba.set_variant("scalar_rgb")


def read(path):
    return numpy.array(mitsuba.Bitmap(path).convert(mitsuba.Bitmap.PixelFormat.RGB, mitsuba.Struct.Type.Float32))


def srgb(linear):
    x = numpy.clip(linear, 0, 1)
    return numpy.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def difference(ours, theirs, side=4):
    mean = lambda x: x.mean(2).reshape(x.shape[0] // side, side, x.shape[1] // side, side).mean((1, 3))
    d = numpy.clip((mean(ours) / mean(theirs) - 1) / 0.05, -1, 1)
    colour = numpy.stack([1 - numpy.maximum(-d, 0), 1 - numpy.abs(d), 1 - numpy.maximum(d, 0)], -1)
    return colour.repeat(side, 0).repeat(side, 1)


files = [sys.argv[1], sys.argv[2], *sys.argv[4:]]
rows = []
for ours, theirs in zip(files[::2], files[1::2]):
    a, b = read(ours), read(theirs)
    print(ours, "mean relative difference of the whole picture: %.4f" % abs(a.mean() / b.mean() - 1))
    gain = 0.6 / numpy.quantile(b, 0.9)
    rows.append(numpy.concatenate([srgb(gain * a), srgb(gain * b), difference(a, b)], 1))
pixels = (255 * numpy.concatenate(rows, 0) + 0.5).astype(numpy.uint8)
mitsuba.Bitmap(pixels).write(sys.argv[3])
