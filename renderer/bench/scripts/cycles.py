"""Renders exported scenes with Blender's Cycles (the package bpy) on command, for `renderflow-bench peers`.

usage: cycles.py THREADS        Commands and answers as in mitsuba.py.

Blender is z up: (x, y, z) becomes (x, -z, y). Its texture rows run up from v = 0, and its environments start a quarter turn earlier.
"""
import json
import math
import os
import pathlib
import resource
import signal
import sys
import tempfile
import time

signal.signal(signal.SIGINT, signal.SIG_IGN)
# This file has the name of one of Blender's modules.
del sys.path[0]
answers = os.fdopen(os.dup(1), "w")
# Blender prints its progress from C.
os.dup2(2, 1)


def say(**answer):
    print(json.dumps(answer), file=answers, flush=True)


threads = int(sys.argv[1])
try:
    import bpy
    import mathutils
    import numpy
except Exception as error:
    say(unavailable=f"{type(error).__name__}: {error}")
    sys.exit(0)

EXTENSIONS = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}
SOCKETS = {"base_color": "Base Color", "emissive": "Emission Color"}
INPUTS = {"metallic": "Metallic", "roughness": "Roughness", "specular": "Specular IOR Level"}
scratch = tempfile.TemporaryDirectory()
size = None


def turn(p):
    return (p[0], -p[2], p[1])


def read_ply(path):
    """Vertex properties by name, and triangles."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    names, counts = [], {}
    for words in (line.split() for line in header.decode().splitlines()):
        if words[0] == "element":
            counts[words[1]] = int(words[2])
        elif words[:2] == ["property", "float"]:
            names.append(words[2])
    end = counts["vertex"] * len(names) * 4
    vertices = numpy.frombuffer(body[:end], "<f4").reshape(-1, len(names))
    faces = numpy.frombuffer(body[end:], [("count", "u1"), ("corners", "<i4", 3)])["corners"]
    return {name: vertices[:, i] for i, name in enumerate(names)}, faces


def mesh(path, smooth):
    v, faces = read_ply(path)
    result = bpy.data.meshes.new(path.stem)
    result.vertices.add(len(v["x"]))
    result.vertices.foreach_set("co", numpy.stack([v["x"], -v["z"], v["y"]], 1).astype(numpy.float32).ravel())
    result.loops.add(faces.size)
    result.loops.foreach_set("vertex_index", faces.astype(numpy.int32).ravel())
    result.polygons.add(len(faces))
    result.polygons.foreach_set("loop_start", numpy.arange(0, faces.size, 3, dtype=numpy.int32))
    result.update()
    result.polygons.foreach_set("use_smooth", numpy.full(len(faces), smooth))
    if "u" in v:
        layer = result.uv_layers.new(name="uv")
        corners = numpy.stack([v["u"], 1 - v["v"]], 1)[faces.ravel()]
        layer.uv.foreach_set("vector", corners.astype(numpy.float32).ravel())
    if "r" in v:
        colors = numpy.stack([v["r"], v["g"], v["b"], numpy.ones_like(v["r"])], 1)
        result.color_attributes.new("tint", "FLOAT_COLOR", "POINT").data.foreach_set("color", colors.astype(numpy.float32).ravel())
    if smooth:
        result.normals_split_custom_set_from_vertices(numpy.stack([v["nx"], -v["nz"], v["ny"]], 1))
    return result


def image(path, color):
    result = bpy.data.images.load(str(path))
    result.colorspace_settings.name = "sRGB" if color else "Non-Color"
    result.use_half_precision = False
    return result


def math_node(nodes, links, operation, first, second):
    """A node of two numbers, each a socket or a constant."""
    node = nodes.new("ShaderNodeMath")
    node.operation = operation
    for socket, value in zip(node.inputs, (first, second)):
        if isinstance(value, (int, float)):
            socket.default_value = value
        else:
            links.new(value, socket)
    return node.outputs[0]


def mixed(nodes, links, share, first, second):
    """`second` where `share`, a socket or a constant, is 1; `first` where it is 0."""
    mix = nodes.new("ShaderNodeMixShader")
    if isinstance(share, (int, float)):
        mix.inputs[0].default_value = share
    else:
        links.new(share, mix.inputs[0])
    links.new(first, mix.inputs[1])
    links.new(second, mix.inputs[2])
    return mix.outputs[0]


def through(nodes, links, description, color, normal):
    """The clear part; `color` is a socket where the base colour is a texture."""
    clear = description["clear"]
    if clear["form"] == "sheet":
        raise ValueError("rough sheets without an inside have no counterpart")
    if clear["form"] == "body" and description.get("opacity") is not None:
        raise ValueError("blended bodies have no counterpart: radiance is not scaled by the index where light enters or leaves one")
    if clear["form"] == "body":
        shader = nodes.new("ShaderNodeBsdfPrincipled")
        # It takes the root of the base colour where light crosses the surface, because light crosses it twice.
        if color is None:
            shader.inputs["Base Color"].default_value = (*(v * v for v in description["base_color"]), 1)
        else:
            square = nodes.new("ShaderNodeGamma")
            square.inputs[1].default_value = 2
            links.new(color, square.inputs[0])
            links.new(square.outputs[0], shader.inputs["Base Color"])
        shader.inputs["IOR"].default_value = clear["ior"]
        # A width of 0.001 stands for smooth.
        shader.inputs["Roughness"].default_value = math.sqrt(clear["alpha"]) if clear["alpha"] > 1.01e-3 else 0
        shader.inputs["Transmission Weight"].default_value = 1
        if normal:
            links.new(normal, shader.inputs["Normal"])
        return shader.outputs[0]
    # Of a sheet with all reflections between its sides, 2 F / (1 + F) is mirrored. The node turns the index for backs; here it
    # must not.
    fresnel, geometry = nodes.new("ShaderNodeFresnel"), nodes.new("ShaderNodeNewGeometry")
    turned = math_node(nodes, links, "MULTIPLY", geometry.outputs["Backfacing"], 1 / clear["ior"] - clear["ior"])
    links.new(math_node(nodes, links, "ADD", turned, clear["ior"]), fresnel.inputs["IOR"])
    twice = math_node(nodes, links, "MULTIPLY", fresnel.outputs[0], 2.0)
    share = math_node(nodes, links, "DIVIDE", twice, math_node(nodes, links, "ADD", fresnel.outputs[0], 1.0))
    passing, mirror = nodes.new("ShaderNodeBsdfTransparent"), nodes.new("ShaderNodeBsdfAnisotropic")
    passing.inputs["Color"].default_value = (*description["base_color"], 1)
    if color is not None:
        links.new(color, passing.inputs["Color"])
    mirror.inputs["Color"].default_value = (1, 1, 1, 1)
    mirror.inputs["Roughness"].default_value = 0
    return mixed(nodes, links, share, passing.outputs[0], mirror.outputs[0])


def material(folder, thing, notes):
    description = thing["material"]
    result = bpy.data.materials.new(thing["name"])
    result.use_nodes = True
    nodes, links = result.node_tree.nodes, result.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    shader = nodes.new("ShaderNodeBsdfPrincipled")
    shader.inputs["Base Color"].default_value = (*description["base_color"], 1)
    shader.inputs["IOR"].default_value = 1.5
    for name, value in description["parameters"].items():
        if name in INPUTS:
            shader.inputs[INPUTS[name]].default_value = value
        else:
            notes.add(f"{name} is left out")
    if any(description["emissive"]):
        shader.inputs["Emission Color"].default_value = (*description["emissive"], 1)
        shader.inputs["Emission Strength"].default_value = 1
    hidden, sockets, normal = [], {}, None
    if description.get("vertex_colors"):
        attribute = nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = "tint"
        sockets["base_color"] = attribute.outputs["Color"]
        links.new(attribute.outputs["Color"], shader.inputs["Base Color"])
    for name, file in description["textures"].items():
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = image(folder / file["file"], name == "base_color")
        texture.extension = EXTENSIONS[file["wrap"]]
        sockets[name] = texture.outputs["Color"]
        if name == "normal":
            bump = nodes.new("ShaderNodeNormalMap")
            bump.uv_map = "uv"
            links.new(texture.outputs["Color"], bump.inputs["Color"])
            normal = bump.outputs["Normal"]
            links.new(normal, shader.inputs["Normal"])
        elif name == "opacity":
            if description.get("opacity") is None:
                # Alpha clip: what is 0 is not there.
                texture.interpolation = "Closest"
            hidden.append(math_node(nodes, links, "SUBTRACT", 1.0, texture.outputs["Color"]))
        elif name != "transmission":
            links.new(texture.outputs["Color"], shader.inputs[SOCKETS.get(name) or INPUTS[name]])
    if not thing["double_sided"]:
        hidden.append(nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"])
    surface, clear = shader.outputs[0], description.get("clear")
    if clear:
        share = sockets.get("transmission", clear["share"])
        surface = mixed(nodes, links, share, surface, through(nodes, links, description, sockets.get("base_color"), normal))
    if description.get("opacity") is not None and "opacity" not in sockets:
        hidden.append(1.0 - description["opacity"])
    for factor in hidden:
        surface = mixed(nodes, links, factor, surface, nodes.new("ShaderNodeBsdfTransparent").outputs[0])
    links.new(surface, output.inputs["Surface"])
    if clear and any(clear["absorption"]):
        most = max(clear["absorption"])
        absorption = nodes.new("ShaderNodeVolumeAbsorption")
        absorption.inputs["Density"].default_value = most
        absorption.inputs["Color"].default_value = (*(1 - v / most for v in clear["absorption"]), 1)
        links.new(absorption.outputs[0], output.inputs["Volume"])
    return result


def environment(target, path, rotation):
    world = bpy.data.worlds.new("world")
    target.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    names = ("TexCoord", "Mapping", "TexEnvironment", "Background", "OutputWorld")
    where, mapping, texture, light, output = (nodes.new(f"ShaderNode{name}") for name in names)
    texture.image = image(path, False)
    mapping.inputs["Rotation"].default_value = (0, 0, math.radians(90 - rotation))
    links.new(where.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], light.inputs["Color"])
    links.new(light.outputs["Background"], output.inputs["Surface"])
    world.cycles.sampling_method = "MANUAL"
    # Light between a bright texel and its neighbours is drawn too seldom from a table of one value a texel.
    world.cycles.sample_map_resolution = min(8192, max(4, 4 * texture.image.size[0]))


def load(path):
    global size
    path = pathlib.Path(path)
    folder, description = path.parent, json.loads(path.read_text())
    notes = set()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    target = bpy.context.scene
    for thing in description["objects"]:
        shape = mesh(folder / thing["mesh"], thing["smooth"])
        try:
            shape.materials.append(material(folder, thing, notes))
        except ValueError as error:
            raise ValueError(f"{thing['name']}: {error}") from None
        placed = bpy.data.objects.new(thing["name"], shape)
        placed.cycles.shadow_terminator_offset = 0
        placed.cycles.shadow_terminator_geometry_offset = 0
        target.collection.objects.link(placed)
    camera = description["camera"]
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.angle = "VERTICAL", math.radians(camera["vertical_fov"])
    lens.clip_start = 1e-3
    placed = bpy.data.objects.new("camera", lens)
    eye, ahead = (mathutils.Vector(turn(camera[name])) for name in ("eye", "target"))
    placed.location = eye
    placed.rotation_euler = (ahead - eye).to_track_quat("-Z", "Y").to_euler()
    target.collection.objects.link(placed)
    target.camera = placed
    environment(target, folder / description["environment"], description["environment_rotation"])

    target.render.engine = "CYCLES"
    cycles = target.cycles
    cycles.device, cycles.use_adaptive_sampling, cycles.use_denoising, cycles.use_auto_tile = "CPU", False, False, False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    # Cycles counts the bounces between surfaces.
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = description["max_bounces"] - 1
    cycles.transmission_bounces = description["max_bounces"] - 1
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    # Surfaces that let a ray pass are no bounces.
    cycles.transparent_max_bounces = 1024
    render = target.render
    render.threads_mode, render.threads = "FIXED", threads
    render.resolution_x, render.resolution_y, render.resolution_percentage = camera["width"], camera["height"], 100
    # Keeps the hierarchy and the tables from one render to the next.
    render.use_persistent_data = True
    settings = render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
    settings.exr_codec = "NONE"
    target.view_settings.view_transform = "Raw"
    size = (camera["height"], camera["width"])
    return sorted(notes)


def processor():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def render(spp, seed):
    target = bpy.context.scene
    target.cycles.samples, target.cycles.seed = spp, seed
    path = f"{scratch.name}/picture.exr"
    target.render.filepath = path
    wall, cpu = time.perf_counter(), processor()
    bpy.ops.render.render(write_still=True)
    wall, cpu = time.perf_counter() - wall, processor() - cpu
    picture = image(path, False)
    pixels = numpy.empty(size[0] * size[1] * 4, numpy.float32)
    picture.pixels.foreach_get(pixels)
    bpy.data.images.remove(picture)
    return pixels.reshape(*size, 4)[::-1, :, :3], wall, cpu


say(ready={"name": "Cycles", "version": bpy.app.version_string})
for line in sys.stdin:
    try:
        command = json.loads(line)
        if "load" in command:
            notes = load(command["load"])
            # Builds the hierarchy and the tables.
            render(1, 0)
            say(loaded=True, notes=notes)
        elif "warm" in command:
            render(1, 0)
            say(warm=True)
        elif "render" in command:
            picture, wall, cpu = render(command["render"]["spp"], command["render"]["seed"])
            picture.astype("<f4").tofile(command["render"]["file"])
            say(wall=wall, cpu=cpu)
        else:
            say(error=f"unknown command {line.strip()}")
    except Exception as error:
        say(error=f"{type(error).__name__}: {error}")
