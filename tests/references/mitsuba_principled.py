"""Values of Mitsuba 3's `principled` for tests/published.rs: BSDF times cosine for pairs of directions and many materials.

Directions are in the local frame (+z normal, +x tangent), unit to single precision: `wo` towards the viewer (Mitsuba's `wi`),
`wi` towards the light. Three kinds of pairs: cosine-distributed, close to the mirror direction (so that narrow lobes are seen), and
grazing (one or both cosines 0.05 or 0.15). Materials carry the names of this project.
Run: python tests/references/mitsuba_principled.py > tests/references/mitsuba_principled.json
"""
import json

import mitsuba
import numpy

mitsuba.set_variant("scalar_rgb")

COLOR, WARM, WHITE = [0.6, 0.4, 0.2], [0.9, 0.6, 0.3], [1.0, 1.0, 1.0]
MATERIALS = {
    "default": dict(base_color=COLOR, roughness=0.5),
    "no specular": dict(base_color=COLOR, roughness=0.5, specular=0.0),
    "rough diffuse": dict(base_color=COLOR, roughness=1.0, specular=0.0),
    "smooth diffuse": dict(base_color=COLOR, roughness=0.0, specular=0.0),
    "tinted specular": dict(base_color=COLOR, roughness=0.3, specular_tint=1.0),
    "half tinted": dict(base_color=COLOR, roughness=0.3, specular=1.0, specular_tint=0.5),
    "strong specular": dict(base_color=WHITE, roughness=0.25, specular=1.0, specular_tint=1.0),
    "mirror metal": dict(base_color=WARM, metallic=1.0, roughness=0.02),
    "metal": dict(base_color=WARM, metallic=1.0, roughness=0.3),
    "rough metal": dict(base_color=WARM, metallic=1.0, roughness=1.0),
    "half metal": dict(base_color=WARM, metallic=0.5, roughness=0.4, specular_tint=1.0),
    "anisotropic metal": dict(base_color=WARM, metallic=1.0, roughness=0.4, anisotropic=0.8),
    "fully anisotropic": dict(base_color=WARM, metallic=1.0, roughness=0.05, anisotropic=1.0),
    "anisotropic dielectric": dict(base_color=COLOR, roughness=0.6, anisotropic=0.5, specular_tint=1.0),
    "sheen": dict(base_color=COLOR, roughness=0.8, specular=0.0, sheen=1.0),
    "tinted sheen": dict(base_color=COLOR, roughness=0.8, specular=0.0, sheen=0.7, sheen_tint=1.0),
    "clearcoat": dict(base_color=COLOR, roughness=0.6, specular_tint=1.0, clearcoat=1.0, clearcoat_gloss=0.0),
    "glossy clearcoat": dict(base_color=COLOR, roughness=0.6, specular_tint=1.0, clearcoat=0.8, clearcoat_gloss=0.9),
    "sharp clearcoat": dict(base_color=COLOR, roughness=0.6, specular_tint=1.0, clearcoat=1.0, clearcoat_gloss=1.0),
    "subsurface": dict(base_color=COLOR, roughness=0.5, specular=0.0, subsurface=1.0),
    "half subsurface": dict(base_color=COLOR, roughness=0.9, specular_tint=1.0, subsurface=0.5),
    "everything": dict(base_color=[0.2, 0.5, 0.8], metallic=0.3, roughness=0.45, specular=0.7, specular_tint=0.4, anisotropic=0.6,
                       sheen=0.5, sheen_tint=0.3, clearcoat=0.6, clearcoat_gloss=0.4, subsurface=0.35),
    "black": dict(base_color=[0.0, 0.0, 0.0], roughness=0.4, specular_tint=1.0, sheen=0.5, sheen_tint=1.0),
}
NAMES = {"specular_tint": "spec_tint", "subsurface": "flatness"}


def unit(cos, phi):
    sin = numpy.sqrt(1 - cos**2)
    return numpy.stack([sin * numpy.cos(phi), sin * numpy.sin(phi), cos], -1)


def pairs():
    random = numpy.random.Generator(numpy.random.PCG64(7))
    turn = lambda n: 2 * numpy.pi * random.random(n)
    wo = unit(numpy.sqrt(random.random(40)), turn(40))
    wi = unit(numpy.sqrt(random.random(40)), turn(40))
    # Near the mirror direction: half vectors at slopes from a tenth of the smallest lobe's width to a few times the widest one's.
    cos = 0.1 + 0.85 * random.random(48)
    near = unit(cos, turn(48))
    slope = 10 ** numpy.linspace(-4, -0.3, 48)
    angle = turn(48)
    h = numpy.stack([slope * numpy.cos(angle), slope * numpy.sin(angle), numpy.ones(48)], -1)
    h /= numpy.linalg.norm(h, axis=-1, keepdims=True)
    mirrored = 2 * (near * h).sum(-1, keepdims=True) * h - near
    keep = mirrored[:, 2] > 0.04
    grazing_o = unit(numpy.repeat([0.05, 0.15], 8), turn(16))
    grazing_i = unit(numpy.tile([0.05, 0.15, 0.5, 0.95], 4), turn(16))
    # Forward and backward at grazing angles.
    low = unit(numpy.full(4, 0.05), numpy.array([0.0, 1.0, 2.0, 3.0]))
    forward = low * [-1, -1, 1]
    wo = numpy.concatenate([wo, near[keep], grazing_o, low, low])
    wi = numpy.concatenate([wi, mirrored[keep], grazing_i, forward, low + [0, 0, 0.02]])
    norm = lambda v: (v / numpy.linalg.norm(v, axis=-1, keepdims=True)).astype(numpy.float32)
    return norm(wo), norm(wi)


def digits(values, n):
    return [float(f"{float(v):.{n}g}") for v in values]


wo, wi = pairs()
lines = []
for name, material in MATERIALS.items():
    plugin = {"type": "principled"}
    for key, value in material.items():
        plugin[NAMES.get(key, key)] = {"type": "rgb", "value": value} if key == "base_color" else value
    bsdf = mitsuba.load_dict(plugin)
    interaction = mitsuba.SurfaceInteraction3f()
    values = []
    for o, i in zip(wo, wi):
        interaction.wi = mitsuba.Vector3f(*o.tolist())
        values.append(digits(bsdf.eval(mitsuba.BSDFContext(), interaction, mitsuba.Vector3f(*i.tolist())), 7))
    lines.append(json.dumps({"name": name, "material": material, "f_cos": values}, separators=(",", ":")))
print('{"mitsuba": "%s",' % mitsuba.__version__)
print('"wo": %s,' % json.dumps([digits(v, 9) for v in wo], separators=(",", ":")))
print('"wi": %s,' % json.dumps([digits(v, 9) for v in wi], separators=(",", ":")))
print('"materials": [\n%s\n]}' % ",\n".join(lines))
