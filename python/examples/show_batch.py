"""Loads a batch through a PyTorch DataLoader and writes it as a PNG grid: show_batch.py SHARDS OUT.png [SPLIT]

Rows are frames; columns are the picture, albedo, normal, depth (near = bright) and material (roughness, metallic, specular)."""
import sys

import numpy as np
import torch
from PIL import Image
from renderflow._frame import srgb
from renderflow.torch import ShardDataset


def main(folder, out, split="train"):
    loader = torch.utils.data.DataLoader(ShardDataset(folder, split), batch_size=4, num_workers=2)
    batch = next(iter(loader))
    for name, value in batch.items():
        print(f"{name:10}", tuple(value.shape) if torch.is_tensor(value) else value)
    rows = []
    for i in range(len(batch["key"])):
        layer = {name: value[i].permute(1, 2, 0).numpy() for name, value in batch.items() if np.ndim(value) == 4}
        nearest = np.min(layer["depth"])
        depth = np.repeat(nearest / layer["depth"], 3, -1) if np.isfinite(nearest) else np.zeros_like(layer["beauty"])
        picture = srgb(layer["beauty"] * float(batch["exposure"][i]))
        rows.append(np.concatenate([picture, srgb(layer["albedo"]), layer["normal"] / 2 + 0.5, depth, layer["material"]], 1))
    Image.fromarray((255 * np.concatenate(rows, 0) + 0.5).astype("u1")).save(out)
    print("wrote", out)


if __name__ == "__main__":
    main(*sys.argv[1:])
