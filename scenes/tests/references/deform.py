#!/usr/bin/env python3
"""Writes deform.gltf and deform.csv: a tube with a skin and morph targets, and where Blender has its vertices.

bpy 5.0.1, numpy (pip); run as `deform.py` in this folder. The file is made here from fixed random numbers: six joints in a chain
below a turned and scaled node, two sets of joints and weights of five joints a vertex, two morph targets, keys at frames 0 to 5
of 24 a second. Blender imports it and evaluates the mesh at each key but the last; a line of the table is frame, vertex, x, y, z in the axes of
glTF, metres. The formulae of glTF 2.0 (sections 3.7.2.2 and 3.7.3.3) in double precision must agree with Blender to 1e-5.
"""

import base64
import json
from pathlib import Path

import bpy
import numpy as np

# The last key ends the animation, which starts again there.
JOINTS, SIDES, RINGS, FRAMES = 6, 6, 11, 6
rng = np.random.default_rng(7)


def quaternion(axis, angle):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return np.append(axis * np.sin(angle / 2), np.cos(angle / 2))


def matrix(translation, rotation, scale):
    x, y, z, w = rotation
    m = np.eye(4)
    m[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    m[:3, :3] *= scale
    m[:3, 3] = translation
    return m


angles = np.arange(SIDES) * 2 * np.pi / SIDES
positions = np.array(
    [[0.2 * np.cos(a), 0.1 * ring, 0.2 * np.sin(a)] for ring in range(RINGS) for a in angles], np.float32
)
triangles = []
for ring in range(RINGS - 1):
    for side in range(SIDES):
        a, b = ring * SIDES + side, ring * SIDES + (side + 1) % SIDES
        triangles += [[a, a + SIDES, b], [b, a + SIDES, b + SIDES]]
targets = rng.uniform(-0.1, 0.1, (2, len(positions), 3)).astype(np.float32)
joints = np.array([rng.permutation(JOINTS) for _ in positions])
weights = rng.dirichlet(np.ones(5), len(positions))
sets = [np.round(weights[:, :4] * 65535).astype(np.uint16), np.zeros((len(positions), 4), np.uint8)]
sets[1][:, 0] = np.round(weights[:, 4] * 255)

# The root is turned and scaled; joints stand one above the other, in bind pose and at rest.
root = ([0.3, -0.2, 0.1], quaternion([1, 2, 3], 0.7), 1.5)
step = [0.0, 0.2, 0.0]
binds = [np.linalg.inv(matrix([0, 0.2 * j, 0], [0, 0, 0, 1], 1)) for j in range(JOINTS)]
turns = np.array(
    [[quaternion(rng.normal(size=3), rng.uniform(-0.8, 0.8)) for _ in range(FRAMES)] for _ in range(JOINTS)], np.float32
)
# Blender keeps weights within 0..1.
morphs = rng.uniform(0, 1, (FRAMES, 2)).astype(np.float32)
times = (np.arange(FRAMES) / 24).astype(np.float32)

buffer, views, accessors = b"", [], []


def put(array, kind, component, normalized=False, bounds=False):
    global buffer
    buffer += bytes(-len(buffer) % 4)
    data = np.ascontiguousarray(array).tobytes()
    views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(data)})
    accessor = {"bufferView": len(views) - 1, "componentType": component, "type": kind, "count": len(array)}
    if normalized:
        accessor["normalized"] = True
    if bounds:
        accessor["min"], accessor["max"] = np.min(array, 0).ravel().tolist(), np.max(array, 0).ravel().tolist()
    accessors.append(accessor)
    buffer += data
    return len(accessors) - 1


second = np.zeros((len(positions), 4), np.uint16)
second[:, 0] = joints[:, 4]
attributes = {
    "POSITION": put(positions, "VEC3", 5126, bounds=True),
    "JOINTS_0": put(joints[:, :4].astype(np.uint8), "VEC4", 5121),
    "WEIGHTS_0": put(sets[0], "VEC4", 5123, True),
    "JOINTS_1": put(second, "VEC4", 5123),
    "WEIGHTS_1": put(sets[1], "VEC4", 5121, True),
}
indices = put(np.array(triangles, np.uint16).ravel(), "SCALAR", 5123)
morph_targets = [{"POSITION": put(target, "VEC3", 5126, bounds=True)} for target in targets]
inverse = put(np.array([m.T for m in binds], np.float32), "MAT4", 5126)
key = put(times.reshape(-1, 1), "SCALAR", 5126, bounds=True)
samplers = [{"input": key, "output": put(turns[j], "VEC4", 5126)} for j in range(JOINTS)]
samplers.append({"input": key, "output": put(morphs.reshape(-1, 1), "SCALAR", 5126)})
channels = [{"sampler": j, "target": {"node": 2 + j, "path": "rotation"}} for j in range(JOINTS)]
channels.append({"sampler": JOINTS, "target": {"node": 1, "path": "weights"}})
nodes = [
    {"name": "root", "translation": root[0], "rotation": list(root[1]), "scale": [root[2]] * 3, "children": [1, 2]},
    # The transform of a skinned mesh's own node is not used.
    {"name": "tube", "mesh": 0, "skin": 0, "translation": [5, 6, 7]},
]
for j in range(JOINTS):
    node = {"name": f"joint {j}", "translation": step if j else [0, 0, 0]}
    if j + 1 < JOINTS:
        node["children"] = [3 + j]
    nodes.append(node)
document = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": nodes,
    "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "targets": morph_targets}]}],
    "skins": [{"joints": list(range(2, 2 + JOINTS)), "inverseBindMatrices": inverse}],
    "animations": [{"name": "bend", "samplers": samplers, "channels": channels}],
    "accessors": accessors,
    "bufferViews": views,
    "buffers": [{"byteLength": len(buffer), "uri": "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()}],
}
path = Path(__file__).with_name("deform.gltf")
path.write_text(json.dumps(document) + "\n")

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 24
bpy.ops.import_scene.gltf(filepath=str(path))
tube = next(o for o in bpy.data.objects if o.type == "MESH" and len(o.data.vertices) == len(positions))
rows, worst = [], 0.0
for frame in range(FRAMES - 1):
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    posed = tube.evaluated_get(graph)
    found = np.array([posed.matrix_world @ v.co for v in posed.to_mesh().vertices])
    # From Blender's z up to y up.
    found = np.stack([found[:, 0], found[:, 2], -found[:, 1]], 1)
    posed.to_mesh_clear()
    world, matrices = matrix(*root), []
    for j in range(JOINTS):
        world = world @ matrix(step if j else [0, 0, 0], turns[j, frame] / np.linalg.norm(turns[j, frame]), 1)
        matrices.append(world @ binds[j])
    shares = np.concatenate([sets[0] / 65535, sets[1][:, :1] / 255], 1)
    shares = shares / shares.sum(1, keepdims=True)
    morphed = positions + np.tensordot(morphs[frame].astype(float), targets.astype(float), 1)
    blend = np.einsum("vk,vkij->vij", shares, np.array(matrices)[joints[:, :5]])
    expected = np.einsum("vij,vj->vi", blend[:, :3, :3], morphed) + blend[:, :3, 3]
    worst = max(worst, np.abs(found - expected).max())
    rows += [f"{frame},{v},{x:.6f},{y:.6f},{z:.6f}" for v, (x, y, z) in enumerate(found)]
print("largest difference to the formulae:", worst)
assert worst < 1e-5, worst
Path(__file__).with_name("deform.csv").write_text("frame,vertex,x,y,z\n" + "\n".join(rows) + "\n")
