#!/usr/bin/env python3
"""Makes mitsuba_lights.csv: Mitsuba's pictures of a box on a floor under four lights, as means of 4 x 3 blocks of the picture.

    pip install mitsuba==3.9.1 && python renderer/tests/references/mitsuba_lights.py > renderer/tests/references/mitsuba_lights.csv

Mitsuba's spot has another falloff and its profiles other forms, so points, directional lights and surfaces are compared.
"""

import math
import sys

import mitsuba as mi

mi.set_variant("scalar_rgb")
T = mi.ScalarTransform4f


def grey(value):
    return {"type": "rgb", "value": [value] * 3}


def scene(light):
    albedo = {"type": "diffuse", "reflectance": grey(0.5)}
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4, "rr_depth": 100},
        "sensor": {
            "type": "perspective", "fov_axis": "y", "fov": 40.0,
            "to_world": T().look_at(origin=[0.0, 3.0, 5.0], target=[0.0, 0.3, 0.0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
            "sampler": {"type": "independent", "sample_count": int(sys.argv[1]) if len(sys.argv) > 1 else 32768},
        },
        "floor": {"type": "rectangle", "to_world": T().rotate([1, 0, 0], -90).scale(4.0), "bsdf": albedo},
        "box": {"type": "cube", "to_world": T().translate([0, 0.5, 0]).scale([0.4, 0.5, 0.4]), "bsdf": albedo},
        "light": light,
    })


panel = [2.0, 0.5]
LIGHTS = {
    "point": {"type": "point", "position": [1.0, 2.0, 1.0], "intensity": grey(8.0)},
    "directional": {"type": "directional", "direction": [-1.0, -2.0, -0.5], "irradiance": grey(3.0)},
    "rectangle": {
        "type": "rectangle",
        "to_world": T().translate([-1, 2.5, 0]).rotate([1, 0, 0], 90).scale([panel[0] / 2, panel[1] / 2, 1]),
        "emitter": {"type": "area", "radiance": grey(30.0 / (math.pi * panel[0] * panel[1]))},
    },
    "sphere": {
        "type": "sphere", "center": [1.5, 2.8, 2.5], "radius": 0.25,
        "emitter": {"type": "area", "radiance": grey(30.0 / (math.pi * 4 * math.pi * 0.25**2))},
    },
}

for name, light in LIGHTS.items():
    picture = mi.TensorXf(mi.render(scene(light))).numpy()[:, :, 0]
    blocks = picture.reshape(3, 16, 4, 16).mean(axis=(1, 3))
    print(name, *(f"{v:.5f}" for v in blocks.flatten()), sep=",")
