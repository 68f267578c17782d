"""Pictures by Blender's Cycles (`bpy`) for tests/cycles.rs: means of 8x8 blocks of the scenes in cycles_scenes.json.

`diffuse` is Cycles' diffuse BSDF of roughness 0 (Lambert); `metal` its glossy BSDF of colour white, where Fresnel is 1 at every angle:
distribution GGX (one scattering) in scenes of mode `published`, MULTI_GGX (compensated) in scenes of mode `conserving`.
Blender is z up: (x, y, z) of the scene file becomes (x, -z, y). Its equirectangular maps start a quarter turn earlier.
Two runs with different seeds give the standard error of a block's mean, as a share of it.
Run: python tests/references/cycles_means.py [PICTURES [SCENE...]]     (bpy 5.0.1, Python 3.11)
"""
import json
import math
import pathlib
import sys
import tempfile

import bpy
import mathutils
import numpy

SIZE, BLOCKS, SPP, RUNS = 128, 8, 512, 2
HERE = pathlib.Path(__file__).parent
turn = lambda p: (p[0], -p[2], p[1])


def sky(width=1024, height=512):
    v = (numpy.arange(height) + 0.5) / height
    u = (numpy.arange(width) + 0.5) / width
    theta, phi = numpy.pi * v[:, None], 2 * numpy.pi * u[None, :]
    x, y, z = numpy.sin(phi) * numpy.sin(theta), numpy.cos(theta) + 0 * phi, -numpy.cos(phi) * numpy.sin(theta)
    glow = numpy.exp(8 * ((x * 0.6 + y * 0.64 + z * 0.48) - 1))
    up = 0.5 + 0.5 * y
    return numpy.stack([0.3 + 0.2 * up + 6 * glow, 0.3 + 0.4 * up + 5 * glow, 0.3 + 0.7 * up + 4 * glow], -1).astype(numpy.float32)


def sphere(center, radius, segments=192, rings=96):
    normals, faces = [], []
    for r in range(rings + 1):
        theta = math.pi * r / rings
        for s in range(segments):
            phi = 2 * math.pi * s / segments
            normals.append(turn((math.sin(theta) * math.sin(phi), math.cos(theta), math.sin(theta) * math.cos(phi))))
    index = lambda r, s: r * segments + s % segments
    for r in range(rings):
        for s in range(segments):
            a, b, c, d = index(r, s), index(r + 1, s), index(r + 1, s + 1), index(r, s + 1)
            if r < rings - 1:
                faces.append((a, b, c))
            if r > 0:
                faces.append((a, c, d))
    center = turn(center)
    return [tuple(c + radius * x for c, x in zip(center, n)) for n in normals], faces, normals


def add(name, vertices, faces, normals, material):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    if normals:
        mesh.shade_smooth()
        mesh.normals_split_custom_set_from_vertices(normals)
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    thing.cycles.shadow_terminator_offset = 0
    thing.cycles.shadow_terminator_geometry_offset = 0
    bpy.context.scene.collection.objects.link(thing)


def shader(name, description, mode):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    if "diffuse" in description:
        node = nodes.new("ShaderNodeBsdfDiffuse")
        node.inputs["Color"].default_value = (*description["diffuse"], 1)
        node.inputs["Roughness"].default_value = 0
    else:
        node = nodes.new("ShaderNodeBsdfAnisotropic")
        node.distribution = {"published": "GGX", "conserving": "MULTI_GGX"}[mode]
        node.inputs["Color"].default_value = (1, 1, 1, 1)
        node.inputs["Roughness"].default_value = description["metal"]
    material.node_tree.links.new(node.outputs["BSDF"], output.inputs["Surface"])
    return material


def prepare(folder, scene):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    target = bpy.context.scene
    target.render.engine = "CYCLES"
    c = target.cycles
    c.device, c.samples, c.use_adaptive_sampling, c.use_denoising = "CPU", SPP, False, False
    # Six surfaces a path: Cycles counts the bounces between them.
    c.max_bounces = c.diffuse_bounces = c.glossy_bounces = 5
    c.min_light_bounces = 16
    c.sample_clamp_direct = c.sample_clamp_indirect = 0
    c.blur_glossy, c.light_sampling_threshold, c.pixel_filter_type = 0, 0, "BOX"
    c.caustics_reflective = True
    target.render.resolution_x = target.render.resolution_y = SIZE
    target.render.resolution_percentage = 100
    target.render.image_settings.file_format = "OPEN_EXR"
    target.render.image_settings.color_depth = "32"

    world = bpy.data.worlds.new("sky")
    target.world = world
    world.use_nodes = True
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 1024
    nodes = world.node_tree.nodes
    nodes.clear()
    texture, light, output = (nodes.new(f"ShaderNode{k}") for k in ("TexEnvironment", "Background", "OutputWorld"))
    texels = numpy.roll(sky(), sky().shape[1] // 4, axis=1)[::-1]
    texels = numpy.concatenate([texels, numpy.ones_like(texels[..., :1])], -1)
    image = bpy.data.images.new("sky", texels.shape[1], texels.shape[0], float_buffer=True, is_data=True)
    image.pixels.foreach_set(texels.ravel())
    image.pack()
    texture.image = image
    world.node_tree.links.new(texture.outputs["Color"], light.inputs["Color"])
    world.node_tree.links.new(light.outputs["Background"], output.inputs["Surface"])

    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.angle = "VERTICAL", math.radians(scene["vertical_fov"])
    camera = bpy.data.objects.new("camera", lens)
    eye, look = mathutils.Vector(turn(scene["eye"])), mathutils.Vector(turn(scene["target"]))
    camera.location = eye
    camera.rotation_euler = (look - eye).to_track_quat("-Z", "Y").to_euler()
    target.collection.objects.link(camera)
    target.camera = camera

    materials = {n: shader(n, m, scene["mode"]) for n, m in scene["materials"].items()}
    for i, s in enumerate(scene["spheres"]):
        add(f"sphere{i}", *sphere(s["center"], s["radius"]), materials[s["material"]])
    for i, q in enumerate(scene["quads"]):
        add(f"quad{i}", [turn(p) for p in q["corners"]], [(0, 1, 2, 3)], None, materials[q["material"]])


def render(path):
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = numpy.empty(SIZE * SIZE * 4, numpy.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(SIZE, SIZE, 4)[::-1, :, :3].astype(float)


target = HERE / "cycles_means.json"
result = json.loads(target.read_text()) if target.exists() else {"scenes": {}}
result |= {"cycles": bpy.app.version_string, "size": SIZE, "spp": SPP * RUNS}
scenes = json.loads((HERE / "cycles_scenes.json").read_text())
with tempfile.TemporaryDirectory() as temporary:
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else temporary)
    for name in sys.argv[2:] or scenes:
        runs = []
        for seed in range(RUNS):
            prepare(folder, scenes[name])
            bpy.context.scene.cycles.seed = seed
            runs.append(render(folder / f"{name}{seed}.exr"))
        b = SIZE // BLOCKS
        blocks = numpy.stack(runs).reshape(RUNS, BLOCKS, b, BLOCKS, b, 3).mean((2, 4))
        noise = float((blocks.std(0, ddof=1) / math.sqrt(RUNS) / blocks.mean(0)).mean())
        print(name, "noise of a block:", noise, file=sys.stderr)
        result["scenes"][name] = {"noise": float(f"{noise:.2g}"), "blocks": numpy.round(blocks.mean(0), 5).tolist()}
        target.write_text(json.dumps(result, separators=(",", ":")).replace('"noise"', '\n"noise"') + "\n")
