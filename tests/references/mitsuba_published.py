"""Pictures by Mitsuba 3's `principled` for tests/published.rs: means of 8x8 blocks of the scenes in published_scenes.json.

Spheres, quads, the sky and the two small textures are written by the same formulae on both sides. The glTF model is read here from its
buffers, without any scene library. Scene `fresnel` is rendered a second time as `fresnel_exact`, with `spec_tint` 0.
Stored beside the blocks: the standard error of the block means as a share of them, from four independent renders.
Run: DRJIT_LIBLLVM_PATH=... python tests/references/mitsuba_published.py FOLDER_OF_SUZANNE_GLTF [PICTURES [SCENE...]]
Writes mitsuba_published.json beside this file, scene by scene; with a second argument also one EXR a scene into that folder.
"""
import json
import math
import pathlib
import sys
import tempfile

import mitsuba
import numpy

mitsuba.set_variant("llvm_ad_rgb")

SIZE, BLOCKS, SPP, RUNS = 128, 8, 2048, 4
NAMES = {"specular_tint": "spec_tint", "subsurface": "flatness"}
HERE = pathlib.Path(__file__).parent
MODELS = pathlib.Path(sys.argv[1])


def sphere_obj(path, center, radius, segments=192, rings=96):
    """Positions, radial normals, texture coordinates; one seam."""
    with open(path, "w") as f:
        for r in range(rings + 1):
            theta = math.pi * r / rings
            for s in range(segments + 1):
                phi = 2 * math.pi * s / segments
                n = (math.sin(theta) * math.sin(phi), math.cos(theta), math.sin(theta) * math.cos(phi))
                p = tuple(c + radius * x for c, x in zip(center, n))
                f.write("v %.9g %.9g %.9g\nvn %.9g %.9g %.9g\nvt %.9g %.9g\n" % (p + n + (s / segments, 1 - r / rings)))
        index = lambda r, s: r * (segments + 1) + s + 1
        for r in range(rings):
            for s in range(segments):
                a, b, c, d = index(r, s), index(r + 1, s), index(r + 1, s + 1), index(r, s + 1)
                if r < rings - 1:
                    f.write(f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}\n")
                if r > 0:
                    f.write(f"f {a}/{a}/{a} {c}/{c}/{c} {d}/{d}/{d}\n")


def quad_obj(path, corners):
    a, b, c = (numpy.array(corners[i], float) for i in range(3))
    n = numpy.cross(b - a, c - a)
    n /= numpy.linalg.norm(n)
    with open(path, "w") as f:
        for p, t in zip(corners, [(0, 0), (1, 0), (1, 1), (0, 1)]):
            f.write("v %g %g %g\nvt %g %g\nvn %g %g %g\n" % (*p, *t, *n))
        f.write("f 1/1/1 2/2/2 3/3/3\nf 1/1/1 3/3/3 4/4/4\n")


def sky(width=1024, height=512):
    v = (numpy.arange(height) + 0.5) / height
    u = (numpy.arange(width) + 0.5) / width
    theta, phi = numpy.pi * v[:, None], 2 * numpy.pi * u[None, :]
    x, y, z = numpy.sin(phi) * numpy.sin(theta), numpy.cos(theta) + 0 * phi, -numpy.cos(phi) * numpy.sin(theta)
    glow = numpy.exp(8 * ((x * 0.6 + y * 0.64 + z * 0.48) - 1))
    up = 0.5 + 0.5 * y
    return numpy.stack([0.3 + 0.2 * up + 6 * glow, 0.3 + 0.4 * up + 5 * glow, 0.3 + 0.7 * up + 4 * glow], -1).astype(numpy.float32)


def write_textures(folder):
    y, x = numpy.mgrid[0:64, 0:64]
    checker = (x // 8 + y // 8) % 2
    pattern = numpy.stack([4 * x, 252 - 4 * y, 60 + 140 * checker], -1)
    layers = numpy.stack([0 * x, 80 + 2 * x, 4 * y], -1)
    for name, pixels in [("pattern.png", pattern), ("layers.png", layers)]:
        mitsuba.Bitmap(pixels.astype(numpy.uint8)).write(str(folder / name))


def layer(folder, path, channel):
    """One channel of an image as a grey image of its own."""
    target = folder / f"{path.stem}.{channel}.png"
    pixels = numpy.array(mitsuba.Bitmap(str(path)))[:, :, channel]
    mitsuba.Bitmap(numpy.ascontiguousarray(pixels)[:, :, None]).write(str(target))
    return str(target)


def gltf_mesh(path, bsdf):
    """The first primitive of the first mesh of a glTF file with one buffer; node transforms must be the identity."""
    document = json.loads(path.read_text())
    assert all(set(n) <= {"mesh", "name"} for n in document["nodes"])
    buffer = (path.parent / document["buffers"][0]["uri"]).read_bytes()

    def accessor(i):
        a = document["accessors"][i]
        view = document["bufferViews"][a["bufferView"]]
        kind = {5126: numpy.float32, 5125: numpy.uint32, 5123: numpy.uint16}[a["componentType"]]
        n = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a["type"]]
        assert "byteStride" not in view or view["byteStride"] == n * numpy.dtype(kind).itemsize
        return numpy.frombuffer(buffer, kind, a["count"] * n, view.get("byteOffset", 0) + a.get("byteOffset", 0)).reshape(-1, n)

    primitive = document["meshes"][0]["primitives"][0]
    p, n, t = (accessor(primitive["attributes"][k]) for k in ("POSITION", "NORMAL", "TEXCOORD_0"))
    faces = accessor(primitive["indices"]).reshape(-1, 3)
    properties = mitsuba.Properties()
    properties["bsdf"] = bsdf
    mesh = mitsuba.Mesh("model", len(p), len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    values = mitsuba.traverse(mesh)
    values["vertex_positions"], values["vertex_normals"] = p.ravel(), n.ravel()
    # Mitsuba's texture rows run down from v = 0, as glTF's do.
    values["vertex_texcoords"], values["faces"] = t.ravel(), faces.astype(numpy.uint32).ravel()
    values.update()
    return mesh


def plugin(folder, material, exact_fresnel):
    result = {"type": "principled", "metallic": 0.0}
    find = lambda name: folder / name if (folder / name).exists() else MODELS / name
    for key, value in material.items():
        if key == "base_color":
            result[key] = {"type": "rgb", "value": value}
        elif key == "base_color_texture":
            result["base_color"] = {"type": "bitmap", "filename": str(find(value))}
        elif key == "metallic_roughness_texture":
            for name, channel in [("roughness", 1), ("metallic", 2)]:
                result[name] = {"type": "bitmap", "filename": layer(folder, find(value), channel), "raw": True}
        elif not (key == "specular_tint" and exact_fresnel):
            result[NAMES.get(key, key)] = value
    return mitsuba.load_dict(result)


def render(folder, scene, exact_fresnel=False):
    bsdfs = {name: plugin(folder, m, exact_fresnel) for name, m in scene["materials"].items()}
    parts = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 7, "rr_depth": 100},
        "sensor": {"type": "perspective", "fov": scene["vertical_fov"], "fov_axis": "y",
                   "to_world": mitsuba.ScalarTransform4f().look_at(scene["eye"], scene["target"], [0, 1, 0]),
                   "sampler": {"type": "independent"},
                   "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}},
        "light": {"type": "envmap", "bitmap": mitsuba.Bitmap(sky())},
    }
    for i, sphere in enumerate(scene.get("spheres", [])):
        path = folder / f"sphere{i}.obj"
        sphere_obj(path, sphere["center"], sphere["radius"])
        parts[f"sphere{i}"] = {"type": "obj", "filename": str(path), "bsdf": bsdfs[sphere["material"]]}
    for i, quad in enumerate(scene["quads"]):
        path = folder / f"quad{i}.obj"
        quad_obj(path, quad["corners"])
        parts[f"quad{i}"] = {"type": "obj", "filename": str(path), "bsdf": bsdfs[quad["material"]]}
    if "model" in scene:
        parts["model"] = gltf_mesh(MODELS / scene["model"]["file"], bsdfs[scene["model"]["material"]])
    scene = mitsuba.load_dict(parts)
    return numpy.stack([numpy.array(mitsuba.render(scene, spp=SPP, seed=s)) for s in range(RUNS)]).astype(float)


target = HERE / "mitsuba_published.json"
result = json.loads(target.read_text()) if target.exists() else {"scenes": {}}
result |= {"mitsuba": mitsuba.__version__, "size": SIZE, "max_depth": 7, "spp": SPP * RUNS}
scenes = json.loads((HERE / "published_scenes.json").read_text())
with tempfile.TemporaryDirectory() as temporary:
    folder = pathlib.Path(temporary)
    write_textures(folder)
    for label in sys.argv[3:] or [*scenes, "fresnel_exact"]:
        runs = render(folder, scenes[label.removesuffix("_exact")], label.endswith("_exact"))
        b = SIZE // BLOCKS
        blocks = runs.reshape(RUNS, BLOCKS, b, BLOCKS, b, 3).mean((2, 4))
        noise = float((blocks.std(0, ddof=1) / math.sqrt(RUNS) / blocks.mean(0)).mean())
        print(label, "noise of a block:", noise, file=sys.stderr)
        result["scenes"][label] = {"noise": float(f"{noise:.2g}"), "blocks": numpy.round(blocks.mean(0), 5).tolist()}
        if len(sys.argv) > 2:
            mitsuba.Bitmap(runs.mean(0).astype(numpy.float32)).write(f"{sys.argv[2]}/{label}.exr")
        target.write_text(json.dumps(result, separators=(",", ":")).replace('"noise"', '\n"noise"') + "\n")
