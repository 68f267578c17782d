"""Reference pictures' means for tests/mitsuba.rs, from Mitsuba 3 (`llvm_ad_rgb` or `scalar_rgb`).

One sphere on a ground plane under a smooth sky. The test builds the same sphere, sky and camera by the same formulae;
stored are the mean radiance of the picture and of an 8x8 grid of blocks.
Run: DRJIT_LIBLLVM_PATH=... python tests/references/mitsuba_means.py > tests/references/mitsuba_means.json
"""
import json
import math
import sys
import tempfile

import mitsuba
import numpy

mitsuba.set_variant(sys.argv[1] if len(sys.argv) > 1 else "llvm_ad_rgb")

SIZE, SPP = 128, 2048


def sphere_obj(path, segments=96, rings=48):
    """A unit sphere; normals are the positions."""
    with open(path, "w") as f:
        for r in range(rings + 1):
            theta = math.pi * r / rings
            for s in range(segments):
                phi = 2 * math.pi * s / segments
                p = (math.sin(theta) * math.sin(phi), math.cos(theta), math.sin(theta) * math.cos(phi))
                f.write("v %.9g %.9g %.9g\nvn %.9g %.9g %.9g\n" % (p + p))
        index = lambda r, s: r * segments + s % segments + 1
        for r in range(rings):
            for s in range(segments):
                a, b, c, d = index(r, s), index(r + 1, s), index(r + 1, s + 1), index(r, s + 1)
                if r < rings - 1:
                    f.write(f"f {a}//{a} {b}//{b} {c}//{c}\n")
                if r > 0:
                    f.write(f"f {a}//{a} {c}//{c} {d}//{d}\n")


def sky(width=1024, height=512):
    v = (numpy.arange(height) + 0.5) / height
    u = (numpy.arange(width) + 0.5) / width
    theta, phi = numpy.pi * v[:, None], 2 * numpy.pi * u[None, :]
    x, y, z = numpy.sin(phi) * numpy.sin(theta), numpy.cos(theta) + 0 * phi, -numpy.cos(phi) * numpy.sin(theta)
    glow = numpy.exp(8 * ((x * 0.6 + y * 0.64 + z * 0.48) - 1))
    up = 0.5 + 0.5 * y
    return numpy.stack([0.3 + 0.2 * up + 6 * glow, 0.3 + 0.4 * up + 5 * glow, 0.3 + 0.7 * up + 4 * glow], -1).astype(numpy.float32)


MATERIALS = {
    "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.2]}},
    "metal": {"type": "principled", "base_color": {"type": "rgb", "value": [0.9, 0.6, 0.3]}, "metallic": 1.0, "roughness": 0.3},
    "dielectric": {"type": "principled", "base_color": {"type": "rgb", "value": [0.6, 0.4, 0.2]}, "metallic": 0.0, "roughness": 0.4,
                   "specular": 0.5},
}

result = {"mitsuba": mitsuba.__version__, "size": SIZE, "spp": SPP, "scenes": {}}
with tempfile.TemporaryDirectory() as folder:
    sphere_obj(folder + "/sphere.obj")
    eye, target = [0.0, 1.6, 4.5], [0.0, 0.0, 0.0]
    for name, bsdf in MATERIALS.items():
        scene = mitsuba.load_dict({
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 7, "rr_depth": 100},
            "sensor": {"type": "perspective", "fov": 40, "fov_axis": "y",
                       "to_world": mitsuba.ScalarTransform4f().look_at(eye, target, [0, 1, 0]),
                       "sampler": {"type": "independent", "sample_count": SPP},
                       "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}},
            "light": {"type": "envmap", "bitmap": mitsuba.Bitmap(sky()), "scale": 1.0},
            "sphere": {"type": "obj", "filename": folder + "/sphere.obj", "bsdf": bsdf},
            "ground": {"type": "rectangle",
                       "to_world": mitsuba.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(20),
                       "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}}},
        })
        image = numpy.array(mitsuba.render(scene, spp=SPP))
        blocks = image.reshape(8, SIZE // 8, 8, SIZE // 8, 3).mean((1, 3))
        result["scenes"][name] = {"mean": image.mean((0, 1)).tolist(), "blocks": numpy.round(blocks, 5).tolist()}
print(json.dumps(result))
