"""Seconds and peak memory of the published size in diffusers, on the work of the example `wan_seconds` of renderflow-bench: five 512x512
pictures to latents, one velocity without text, one decoded image; random weights, single precision, CPU.

Ran with torch 2.15.0 and diffusers 0.42.1: python wan_seconds.py [size] [runs]
"""

import resource
import sys
import time

import torch
from diffusers import AutoencoderKLWan, WanTransformer3DModel


class Nothing(torch.nn.Module):
    """In the place of cross-attention, which the renderer does without."""

    def forward(self, x, *_, **__):
        return torch.zeros_like(x)


def clock(what, run):
    start = time.time()
    result = run()
    print(f"{what}: {time.time() - start:.2f} s ({result.abs().mean().item()})", flush=True)
    return result


@torch.no_grad()
def main():
    size, runs = (int(v) for v in (sys.argv[1:] + ["512", "3"][len(sys.argv) - 1 :]))
    torch.manual_seed(1)
    vae = AutoencoderKLWan().eval()
    dit = WanTransformer3DModel(num_attention_heads=12, num_layers=30, ffn_dim=8960).eval()
    for block in dit.blocks:
        block.attn2, block.norm2 = Nothing(), torch.nn.Identity()
    text = torch.zeros(1, 1, 4096)
    for _ in range(runs):
        picture = torch.rand(1, 3, 1, size, size) - 0.5
        latents = clock(
            "five pictures to latents", lambda: torch.cat([vae.encode(picture).latent_dist.mode() for _ in range(5)], 1)
        )[:, :16]
        velocity = clock("velocity", lambda: dit(latents, torch.tensor([1000]), text).sample)
        clock("latents to image", lambda: vae.decode(latents - velocity).sample)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9:.2f} GB")


main()
