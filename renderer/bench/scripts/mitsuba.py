"""Renders exported scenes with Mitsuba 3 on command, for `renderflow-bench peers`.

usage: mitsuba.py VARIANT SAMPLER THREADS        (llvm_ad_rgb multijitter 4)

Commands are JSON objects, one a line, on standard input; answers likewise on standard output (see ../src/peers/child.rs):
  {"load": FILE}                                     FILE is a scene.json as written by ../src/export.rs
  {"warm": {"spps": [...]}}                          compiles what renders of these samples a pixel need
  {"render": {"spp": N, "seed": S, "file": FILE}}    FILE gets height x width x 3 little-endian floats
"""
import glob
import json
import os
import pathlib
import resource
import signal
import sys
import time

# Whoever sends the commands decides when to stop.
signal.signal(signal.SIGINT, signal.SIG_IGN)
# This file has the name of the package.
del sys.path[0]
answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)


def say(**answer):
    print(json.dumps(answer), file=answers, flush=True)


variant, sampler, threads = sys.argv[1], sys.argv[2], int(sys.argv[3])
if "DRJIT_LIBLLVM_PATH" not in os.environ:
    # Versions before 19 cannot compile for some newer processors.
    for version in ("19", "20", "21"):
        found = sorted(glob.glob(f"/usr/lib/*/libLLVM.so.{version}*") + glob.glob(f"/usr/lib/llvm-{version}/lib/libLLVM*.so*"))
        if found:
            os.environ["DRJIT_LIBLLVM_PATH"] = found[0]
            break
try:
    import numpy
    import mitsuba
    import drjit

    mitsuba.set_variant(variant)
    drjit.set_thread_count(threads)
    mitsuba.Thread.set_thread_count(threads) if hasattr(mitsuba.Thread, "set_thread_count") else None
    if variant.startswith("llvm"):
        # Fails here, and not in the first render, where LLVM is missing.
        drjit.eval(mitsuba.Float(1) + drjit.arange(mitsuba.Float, 4))
except Exception as error:
    say(unavailable=f"{type(error).__name__}: {error}")
    sys.exit(0)

PARAMETERS = {"specular_tint": "spec_tint", "subsurface": "flatness"}
scene = None


def rgb(value):
    return {"type": "rgb", "value": [float(v) for v in value]}


def bitmap(folder, texture, raw, interpolated=True):
    return {"type": "bitmap", "filename": str(folder / texture["file"]), "raw": raw, "wrap_mode": texture["wrap"],
            "filter_type": "bilinear" if interpolated else "nearest"}


def through(material, textures, color):
    """The clear part. Ours divides rough lobes by what single scattering loses; Mitsuba's does not."""
    clear = material["clear"]
    if clear["form"] == "sheet":
        raise ValueError("rough sheets without an inside have no counterpart")
    form = "thindielectric" if clear["form"] == "pane" else "dielectric" if clear["alpha"] < 1.01e-3 else "roughdielectric"
    result = {"type": form, "int_ior": clear["ior"], "ext_ior": 1.0, "specular_transmittance": color}
    return result | ({"distribution": "ggx", "alpha": clear["alpha"]} if form == "roughdielectric" else {})


def bsdf(folder, thing):
    material = thing["material"]
    textures = material["textures"]
    clear, opacity = material.get("clear"), material.get("opacity")
    color = bitmap(folder, textures["base_color"], False) if "base_color" in textures else rgb(material["base_color"])
    if material.get("vertex_colors"):
        color = {"type": "mesh_attribute", "name": "vertex_color"}
    if material["lambertian"]:
        # A principled material is not, whatever its roughness.
        result = {"type": "diffuse", "reflectance": color}
    else:
        result = {"type": "principled", "base_color": color}
        result |= {PARAMETERS.get(name, name): float(value) for name, value in material["parameters"].items()}
        result |= {name: bitmap(folder, textures[name], True) for name in ("roughness", "metallic") if name in textures}
    whole = clear is not None and clear["share"] >= 1 and "transmission" not in textures
    if whole:
        result = through(material, textures, color)
    if "normal" in textures:
        result = {"type": "normalmap", "normalmap": bitmap(folder, textures["normal"], True), "bsdf": result}
    if thing["double_sided"] and (thing["seen_from_behind"] or clear) and not whole:
        result = {"type": "twosided", "bsdf": result}
    if clear and not whole:
        if "normal" in textures:
            raise ValueError("normal maps on partly clear surfaces have no counterpart")
        share = bitmap(folder, textures["transmission"], True) if "transmission" in textures else float(clear["share"])
        result = {"type": "blendbsdf", "weight": share, "opaque": result, "through": through(material, textures, color)}
    if "opacity" in textures:
        share = bitmap(folder, textures["opacity"], True, interpolated=opacity is not None)
        result = {"type": "mask", "opacity": share, "bsdf": result}
    elif opacity is not None:
        result = {"type": "mask", "opacity": float(opacity), "bsdf": result}
    return result


def inside(material):
    """What the inside of a body absorbs."""
    absorption = (material.get("clear") or {}).get("absorption", [0, 0, 0])
    most = max(absorption)
    return most and {"type": "homogeneous", "albedo": 0.0, "sigma_t": rgb([v / most for v in absorption]), "scale": float(most)}


def load(path):
    global scene
    path = pathlib.Path(path)
    folder, description = path.parent, json.loads(path.read_text())
    camera = description["camera"]
    transform = mitsuba.ScalarTransform4f()
    things = description["objects"]
    # The light samples of `path` end at surfaces with holes; those of `volpath` pass the holes.
    open_to_light = lambda m: "opacity" in m["textures"] or m.get("opacity") is not None or (m.get("clear") or {}).get("form") == "pane"
    holes = any(open_to_light(thing["material"]) or inside(thing["material"]) for thing in things)
    notes = ["surfaces have holes or an inside: the integrator is volpath"] if holes else []
    rough = [thing["name"] for thing in things if (thing["material"].get("clear") or {}).get("alpha", 0) > 1.01e-3]
    notes += [f"{name}: rough glass, which loses what is scattered more than once between its facets" for name in rough]
    notes += [f"{thing['name']}: single-sided and seen from behind, where it is black in place of letting rays pass"
              for thing in things if thing["seen_from_behind"] and not thing["double_sided"]]
    parts = {
        "type": "scene",
        # Mitsuba counts the emitter as a vertex of the path.
        "integrator": {"type": "volpath" if holes else "path", "max_depth": description["max_bounces"] + 1},
        "sensor": {
            "type": "perspective", "fov": camera["vertical_fov"], "fov_axis": "y",
            "to_world": transform.look_at(origin=camera["eye"], target=camera["target"], up=camera["up"]),
            "film": {"type": "hdrfilm", "width": camera["width"], "height": camera["height"], "rfilter": {"type": "box"},
                     "pixel_format": "rgb", "component_format": "float32"},
            "sampler": {"type": sampler, "sample_count": 16},
        },
        "environment": {"type": "envmap", "filename": str(folder / description["environment"]),
                        "to_world": transform.rotate([0, 1, 0], description["environment_rotation"])},
    }
    for index, thing in enumerate(things):
        try:
            looks = bsdf(folder, thing)
        except ValueError as error:
            raise ValueError(f"{thing['name']}: {error}") from None
        shape = {"type": "ply", "filename": str(folder / thing["mesh"]), "face_normals": not thing["smooth"], "bsdf": looks}
        material = thing["material"]
        if inside(material):
            shape["interior"] = inside(material)
        if any(material["emissive"]):
            light = material["textures"].get("emissive")
            shape["emitter"] = {"type": "area", "radiance": bitmap(folder, light, True) if light else rgb(material["emissive"])}
            if thing["double_sided"] and thing["seen_from_behind"]:
                notes.append(f"{thing['name']}: emits from its front alone")
        parts[f"object_{index:03}"] = shape
    scene = mitsuba.load_dict(parts)
    return notes


def processor():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def render(spp, seed):
    wall, cpu = time.perf_counter(), processor()
    picture = numpy.array(mitsuba.render(scene, spp=spp, seed=seed))
    return picture, time.perf_counter() - wall, processor() - cpu


say(ready={"name": "Mitsuba", "version": mitsuba.__version__})
for line in sys.stdin:
    try:
        command = json.loads(line)
        if "load" in command:
            say(loaded=True, notes=load(command["load"]))
        elif "warm" in command:
            for spp in command["warm"]["spps"]:
                render(spp, 0)
            say(warm=True)
        elif "render" in command:
            picture, wall, cpu = render(command["render"]["spp"], command["render"]["seed"])
            picture[..., :3].astype("<f4").tofile(command["render"]["file"])
            say(wall=wall, cpu=cpu)
        else:
            say(error=f"unknown command {line.strip()}")
    except Exception as error:
        say(error=f"{type(error).__name__}: {error}")
