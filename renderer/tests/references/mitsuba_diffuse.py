"""Reference of tests/gbuffer.rs `interreflection_agrees_with_mitsuba`: diffuse surfaces that light each other under a smooth sky.

    pip install mitsuba==3.* numpy && python mitsuba_diffuse.py > mitsuba_diffuse.csv

Prints mean radiance of each 8x8 block of a 64x64 picture (row, column, r, g, b). The meshes and the sky are the test's own formulae.
"""
import numpy as np
import mitsuba as mi

mi.set_variant("scalar_rgb")


def mesh(name, positions, triangles, reflectance):
    m = mi.Mesh(name, len(positions), len(triangles), props=properties(reflectance))
    p = mi.traverse(m)
    p["vertex_positions"] = np.asarray(positions, np.float32).ravel()
    p["faces"] = np.asarray(triangles, np.uint32).ravel()
    p.update()
    return m


def properties(reflectance):
    p = mi.Properties()
    p["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}})
    p["face_normals"] = True
    return p


def sphere(rings, centre):
    segments, positions, triangles = 2 * rings, [], []
    for i in range(rings + 1):
        theta = np.pi * i / rings
        for j in range(segments + 1):
            phi = 2 * np.pi * (j % segments) / segments
            positions.append([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)])
    row = segments + 1
    for i in range(rings):
        for j in range(segments):
            a, b, c, d = i * row + j, i * row + j + 1, (i + 1) * row + j, (i + 1) * row + j + 1
            if i > 0:
                triangles.append([a, b, c])
            if i + 1 < rings:
                triangles.append([b, d, c])
    return np.array(positions) + np.array(centre), triangles


def sky(width, height):
    """Radiance of direction d: a gradient, and a sun that is a Gaussian of the angle from (0.6, 0.64, 0.48)."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    phi, theta = 2 * np.pi * u, np.pi * v
    d = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1)
    up = 0.5 + 0.5 * d[..., 1]
    sun = 60 * np.exp(-(1 - d @ np.array([0.6, 0.64, 0.48])) / 0.01)
    return np.stack([0.3 + 0.2 * up + sun, 0.4 + 0.4 * up + 0.9 * sun, 0.5 + 0.7 * up + 0.7 * sun], -1).astype(np.float32)


scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 7, "rr_depth": 100},
    "sensor": {
        "type": "perspective",
        "fov": 40,
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 2.5, 5], target=[0, 0.6, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 4096},
    },
    "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky(1024, 512))},
    "floor": mesh("floor", [[-3, 0, -3], [3, 0, -3], [3, 0, 3], [-3, 0, 3]], [[0, 2, 1], [0, 3, 2]], [0.7, 0.6, 0.5]),
    "left": mesh("left", *sphere(16, [-0.95, 1, 0]), [0.8, 0.3, 0.2]),
    "right": mesh("right", *sphere(16, [1.05, 1, 0.2]), [0.4, 0.5, 0.9]),
})
picture = np.array(mi.render(scene))[..., :3].astype(np.float64)
for y in range(8):
    for x in range(8):
        block = picture[8 * y:8 * y + 8, 8 * x:8 * x + 8].reshape(-1, 3).mean(0)
        print(f"{y},{x},{block[0]:.6f},{block[1]:.6f},{block[2]:.6f}")
