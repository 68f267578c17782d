"""exports.py NERFSTUDIO COSMOS COCO PNG: what was exported, read by the rules of the tools it is for.

nerfstudio: the keys and files that nerfstudio/data/dataparsers/nerfstudio_dataparser.py and get_depth_image_from_path,
get_image_mask_tensor_from_path in nerfstudio/data/utils/data_utils.py ask for (github.com/nerfstudio-project/nerfstudio, commit 50e0e3c,
2025-07; the package itself pulls in CUDA extensions). Depths are re-projected from frame to frame, which holds only if axes, units and pixel
centres are what it assumes. Cosmos: the grouping of find_images_recursive and group_images_into_videos (inference_utils.py, commit 0f3e2dc).
COCO: pycocotools."""
import json
import pathlib
import re
import sys

import numpy as np
from PIL import Image
from pycocotools.coco import COCO

nerfstudio, cosmos, coco, png = map(pathlib.Path, sys.argv[1:])
MODELS = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}  # perspective in CAMERA_MODEL_TO_TYPE


def check_nerfstudio(file):
    meta, folder = json.loads(file.read_text()), file.parent
    assert meta["camera_model"] in MODELS and meta["orientation_override"] in ("pca", "up", "vertical", "none")
    assert np.array(meta["applied_transform"]).shape == (3, 4)
    frames = sorted(meta["frames"], key=lambda frame: folder / frame["file_path"])
    assert frames == meta["frames"], "the parser sorts by name: object ids and numbers must follow"
    loaded = []
    for frame in frames:
        own = {**{k: meta[k] for k in ("fl_x", "fl_y", "cx", "cy", "w", "h") if k in meta}, **frame}
        image, depth, mask = (Image.open(folder / frame[key]) for key in ("file_path", "depth_file_path", "mask_path"))
        assert image.mode == "RGB" and image.size == depth.size == mask.size == (own["w"], own["h"])
        assert mask.mode == "L" and set(np.unique(np.asarray(mask))) <= {0, 255}
        metres = np.asarray(depth).astype("f8") * 1e-3  # depth_unit_scale_factor
        assert depth.mode.startswith("I;16") and metres.max() > 0.1
        matrix = np.array(frame["transform_matrix"])
        assert matrix.shape == (4, 4) and np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-4)
        loaded.append((own, matrix, metres, np.asarray(mask) == 255))
    seen = close = 0
    for (a, to_world, depth, mask), (b, other, target, still) in zip(loaded, loaded[1:]):
        y, x = np.nonzero(mask & (depth > 0))
        d = depth[y, x]
        # OpenGL axes, pixel centres at + 0.5, planar depth.
        points = np.stack([(x + 0.5 - a["cx"]) / a["fl_x"] * d, -(y + 0.5 - a["cy"]) / a["fl_y"] * d, -d, np.ones_like(d)])
        px, py, pz, _ = np.linalg.inv(other) @ to_world @ points
        column, row = b["cx"] + b["fl_x"] * px / -pz, b["cy"] - b["fl_y"] * py / -pz
        inside = (pz < 0) & (column >= 0) & (column < b["w"]) & (row >= 0) & (row < b["h"])
        there = row[inside].astype(int), column[inside].astype(int)
        fine = still[there] & (target[there] > 0)
        seen += fine.sum()
        close += (np.abs(target[there] + pz[inside])[fine] < 0.03 * target[there][fine]).sum()
    return seen, close


files = sorted(nerfstudio.glob("*/*/transforms.json"))
seen, close = np.sum([check_nerfstudio(file) for file in files], axis=0)
assert len(files) > 0 and seen > 0 and close > 0.8 * seen, f"{close} of {seen} points at their depth"
print(f"nerfstudio: {len(files)} sequences; {100 * close / seen:.1f} % of {seen} points are at their depth a frame later")

clips = {}
for path in sorted(str(p.relative_to(cosmos)) for p in cosmos.rglob("*.png")):
    key, _ = re.match(r"^((?:.*/|)[^.]+)[.]([^/]*)$", path).groups()
    clips.setdefault(key, []).append(path)
for key, paths in clips.items():
    poses = json.loads((cosmos / (key + ".cameras.json")).read_text())["frames"]
    for label in ("rgb", "basecolor", "normal", "depth", "roughness", "metallic", "env_ldr", "env_log"):
        found = sorted(path for path in paths if f".{label}." in path)
        assert len(found) == len(poses), f"{key}: {len(found)} of {label}"
        assert all(Image.open(cosmos / path).mode == "RGB" for path in found)
    # Its envmap_vec: -latlong_vec flipped both ways.
    directions = np.asarray(Image.open(cosmos / [path for path in paths if ".env_nrm." in path][0])) / 127.5 - 1
    height, width = directions.shape[:2]
    gy, gx = np.meshgrid((np.arange(height) + 0.5) / height, (2 * np.arange(width) + 1) / width - 1, indexing="ij")
    vec = np.stack([np.sin(gy * np.pi) * np.sin(gx * np.pi), np.cos(gy * np.pi), -np.sin(gy * np.pi) * np.cos(gx * np.pi)], -1)
    assert np.abs(directions + vec[::-1, ::-1]).max() < 0.005
print("cosmos:", len(clips), "clips, all labels")

for file in sorted((coco / "annotations").glob("*.json")):
    read = COCO(file)
    for image_id, image in read.imgs.items():
        assert Image.open(coco / file.stem.removeprefix("instances_") / image["file_name"]).size == (image["width"], image["height"])
        total = 0
        for annotation in read.loadAnns(read.getAnnIds(image_id)):
            mask = read.annToMask(annotation)
            rows, columns = np.nonzero(mask)
            box = [columns.min(), rows.min(), columns.max() - columns.min() + 1, rows.max() - rows.min() + 1]
            assert mask.shape == (image["height"], image["width"]) and mask.sum() == annotation["area"] and box == annotation["bbox"]
            assert annotation["category_id"] in read.cats
            total = total + mask
        # The masks of a frame together are its object ids, by the other export.
        sequence, number = image["file_name"].removesuffix(".png").rsplit("_", 1)
        ids = np.asarray(Image.open(png / file.stem.removeprefix("instances_") / sequence / f"object_id_{number}.png"))
        assert (total == (ids > 0)).all()
    print(f"coco: {len(read.imgs)} images, {len(read.anns)} instances of {', '.join(c['name'] for c in read.cats.values())}")
