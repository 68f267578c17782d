"""Reference tensors of the wan networks, made with diffusers from random weights.

    python wan_fixtures.py FOLDER [--seed 7] [--base 8] [--z 4] [--height 40] [--width 56] [--heads 3] [--head-dim 20] ...

Writes what `wan_parity.rs` reads (`RENDERFLOW_FIXTURES=FOLDER cargo test -p renderflow-model parity_`): configurations, weights under
diffusers' names and under the original ones, inputs, outputs and activations. Needs torch, diffusers and safetensors; run with
torch 2.15.0, diffusers 0.42.1, safetensors 0.8.0, one thread.
"""
import argparse
import json
import math
import pathlib
import re

import torch
from diffusers import AutoencoderKLWan, WanTransformer3DModel, WanVACETransformer3DModel
from safetensors.torch import save_file

DIT_TOP = [
    ("condition_embedder.time_embedder.linear_1", "time_embedding.0"),
    ("condition_embedder.time_embedder.linear_2", "time_embedding.2"),
    ("condition_embedder.time_proj", "time_projection.1"),
    ("condition_embedder.text_embedder.linear_1", "text_embedding.0"),
    ("condition_embedder.text_embedder.linear_2", "text_embedding.2"),
    ("scale_shift_table", "head.modulation"),
    ("proj_out", "head.head"),
]
DIT_BLOCK = [
    ("attn1", "self_attn"),
    ("attn2", "cross_attn"),
    ("to_q", "q"),
    ("to_k", "k"),
    ("to_v", "v"),
    ("to_out.0", "o"),
    ("ffn.net.0.proj", "ffn.0"),
    ("ffn.net.2", "ffn.2"),
    ("norm2", "norm3"),
    ("scale_shift_table", "modulation"),
    ("proj_in", "before_proj"),
    ("proj_out", "after_proj"),
]
VAE = [
    (r"^quant_conv", "conv1"),
    (r"^post_quant_conv", "conv2"),
    (r"coder\.conv_in", "coder.@1"),
    (r"down_blocks", "downsamples"),
    (r"mid_block\.resnets\.0", "middle.0"),
    (r"mid_block\.attentions\.0", "middle.1"),
    (r"mid_block\.resnets\.1", "middle.2"),
    (r"norm_out", "head.0"),
    (r"conv_out", "head.2"),
    (r"conv_shortcut", "shortcut"),
    (r"norm1", "residual.0"),
    (r"(\d)\.conv1", r"\1.residual.2"),
    (r"norm2", "residual.3"),
    (r"(\d)\.conv2", r"\1.residual.6"),
    (r"coder\.@1", "coder.conv1"),
]


def dit_original(name):
    rules = DIT_BLOCK if re.match(r"(vace_)?blocks\.", name) else DIT_TOP
    for a, b in rules:
        name = re.sub(rf"(^|\.){re.escape(a)}(\.|$)", rf"\g<1>{b}\g<2>", name)
    return name


def vae_original(name, blocks):
    """`blocks`: residual blocks of a decoder level."""
    name = re.sub(r"up_blocks\.(\d+)\.resnets\.(\d+)", lambda m: f"upsamples.{int(m[1]) * (blocks + 1) + int(m[2])}", name)
    name = re.sub(r"up_blocks\.(\d+)\.upsamplers\.0", lambda m: f"upsamples.{int(m[1]) * (blocks + 1) + blocks}", name)
    for a, b in VAE:
        name = re.sub(a, b, name)
    return name


def randomise(model, seed):
    """Weights whose activations neither vanish nor explode, with no symmetric zeros or ones left."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, p in model.named_parameters():
            noise = torch.randn(p.shape, generator=generator)
            if name.endswith("gamma") or re.search(r"norm\w*\.weight$", name):
                p.copy_(1 + 0.2 * noise)
            elif name.endswith("bias"):
                p.copy_(0.05 * noise)
            elif "scale_shift_table" in name:
                p.copy_(0.3 * noise)
            else:
                p.copy_(noise / math.sqrt(p[0].numel()))


def keep(tensors):
    return {name: tensor.detach().clone().contiguous().float() for name, tensor in tensors.items()}


def write_weights(folder, kind, model, original):
    state = keep(model.state_dict())
    save_file(state, folder / f"{kind}_weights.diffusers.safetensors")
    renamed = {original(name): t for name, t in state.items()}
    save_file(renamed, folder / f"{kind}_weights.original-names.safetensors")
    torch.save(renamed, folder / f"{kind}_weights.original-names.pth")
    names = {name: [original(name), list(t.shape)] for name, t in state.items()}
    (folder / f"{kind}_names.json").write_text(json.dumps(names, indent=0))


def vae(folder, a):
    z = a.z
    config = dict(
        base_dim=a.base, decoder_base_dim=None, z_dim=z, dim_mult=a.dim_mult, num_res_blocks=a.res_blocks, attn_scales=[],
        temperal_downsample=a.temporal, dropout=0.0, latents_mean=[0.1 * i - 0.2 for i in range(z)],
        latents_std=[1 + 0.2 * i for i in range(z)], is_residual=False, in_channels=3, out_channels=3, patch_size=None,
        scale_factor_temporal=2 ** sum(a.temporal), scale_factor_spatial=2 ** (len(a.dim_mult) - 1),
    )
    (folder / "vae_config.json").write_text(json.dumps(config, indent=1))
    model = AutoencoderKLWan(**config).eval()
    randomise(model, a.seed)
    write_weights(folder, "vae", model, lambda name: vae_original(name, a.res_blocks + 1))
    shape = (1, z, 1, 1, 1)
    mean, std = torch.tensor(config["latents_mean"]), torch.tensor(config["latents_std"])
    out = {"latents_mean": mean, "latents_std": std}
    generator = torch.Generator().manual_seed(a.seed + 1)
    hooks, act = [], {}

    def watch(module, name):
        hooks.append(module.register_forward_hook(lambda _, __, y: act.__setitem__(name, y)))

    watch(model.encoder.conv_in, "enc.conv_in")
    watch(model.encoder.mid_block.attentions[0], "enc.mid_attn")
    watch(model.encoder.mid_block, "enc.mid_block")
    watch(model.encoder.norm_out, "enc.norm_out")
    watch(model.encoder.conv_out, "enc.conv_out")
    watch(model.post_quant_conv, "dec.post_quant_conv")
    watch(model.decoder.conv_in, "dec.conv_in")
    watch(model.decoder.mid_block, "dec.mid_block")
    for i, block in enumerate(model.encoder.down_blocks):
        watch(block, f"enc.down_blocks.{i}")
    for i, block in enumerate(model.decoder.up_blocks):
        watch(block, f"dec.up_blocks.{i}")
    for frames in (1, 5, 9):
        f = f"f{frames}"
        x = torch.rand((1, 3, frames, a.height, a.width), generator=generator) * 2 - 1
        posterior = model.encode(x).latent_dist
        out[f"{f}.enc.input"], out[f"{f}.enc.moments"], out[f"{f}.enc.mode"] = x, posterior.parameters, posterior.mode()
        out[f"{f}.enc.mode_normalised"] = (posterior.mode() - mean.view(shape)) / std.view(shape)
        zn = torch.randn(posterior.mode().shape, generator=generator)
        latents = zn * std.view(shape) + mean.view(shape)
        out[f"{f}.dec.input_normalised"], out[f"{f}.dec.input"] = zn, latents
        out[f"{f}.dec.output"] = model.decode(latents).sample
        # The clamp of `decode` is the only thing after the network.
        clamp, torch.clamp = torch.clamp, lambda x, **_: x
        out[f"{f}.dec.output_unclamped"] = model.decode(latents).sample
        torch.clamp = clamp
        if frames == 1:
            out.update({f"f1.act.{name}": y for name, y in act.items()})
            for hook in hooks:
                hook.remove()
    save_file(keep(out), folder / "vae_io.safetensors")


def dit_config(a):
    return dict(
        num_attention_heads=a.heads, attention_head_dim=a.head_dim, ffn_dim=a.ffn, num_layers=a.layers, text_dim=a.text_dim,
        freq_dim=a.freq_dim, in_channels=a.channels, out_channels=a.channels, cross_attn_norm=True,
        qk_norm="rms_norm_across_heads", eps=1e-6, patch_size=[1, 2, 2],
    )


def inputs(a, generator, t):
    latents = torch.randn((1, a.channels, a.frames, a.rows, a.columns), generator=generator)
    return dict(
        hidden_states=latents, timestep=torch.tensor([float(t)]), text=torch.randn((1, a.words, a.text_dim), generator=generator)
    )


def run(model, x, **more):
    return model(x["hidden_states"], timestep=x["timestep"], encoder_hidden_states=x["text"], return_dict=False, **more)[0]


def dit(folder, a):
    config = dit_config(a)
    (folder / "dit_config.json").write_text(json.dumps(config, indent=1))
    model = WanTransformer3DModel(**config).eval()
    randomise(model, a.seed + 2)
    write_weights(folder, "dit", model, dit_original)
    generator, out = torch.Generator().manual_seed(a.seed + 3), {}
    kept = {}
    for t in (1000, 250, 0):
        kept[t] = x = inputs(a, generator, t)
        out.update({f"t{t}.{name}": value for name, value in x.items()})
        out[f"t{t}.output"] = run(model, x)
    # The graph without text: cross-attention returns 0.
    hooks, act = [], {}
    for block in model.blocks:
        hooks.append(block.attn2.register_forward_hook(lambda _, __, y: torch.zeros_like(y)))

    def watch(module, name, take=lambda y: y):
        hooks.append(module.register_forward_hook(lambda _, __, y: act.__setitem__(name, take(y))))

    watch(model.condition_embedder.timesteps_proj, "timestep_sinusoid")
    watch(model.condition_embedder.time_embedder, "temb")
    watch(model.condition_embedder.time_proj, "time_proj")
    watch(model.rope, "rope_cos", lambda y: y[0])
    watch(model.rope, "rope_sin", lambda y: y[1])
    watch(model.patch_embedding, "patch_embedding")
    watch(model.blocks[0].attn1, "block0.attn1")
    watch(model.blocks[0], "block0")
    out["t250.nocross.output"] = run(model, kept[250])
    out.update({f"t250.nocross.act.{name}": y for name, y in act.items()})
    save_file(keep(out), folder / "dit_io.safetensors")


def vace(folder, a):
    config = dict(dit_config(a), vace_layers=a.vace_layers, vace_in_channels=a.vace_channels)
    (folder / "vace_config.json").write_text(json.dumps(config, indent=1))
    model = WanVACETransformer3DModel(**config).eval()
    randomise(model, a.seed + 4)
    save_file(keep(model.state_dict()), folder / "vace_weights.diffusers.safetensors")
    generator = torch.Generator().manual_seed(a.seed + 5)
    x = inputs(a, generator, 600)
    control = torch.randn((1, a.vace_channels, a.frames, a.rows, a.columns), generator=generator)
    scale = torch.ones(len(a.vace_layers))
    output = run(model, x, control_hidden_states=control, control_hidden_states_scale=scale)
    save_file(keep(dict(x, control=control, output=output)), folder / "vace_io.safetensors")


def numbers(text):
    return [int(part) for part in text.split(",")]


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("folder", type=pathlib.Path)
    p.add_argument("--seed", type=int, default=7)
    p.add_argument("--base", type=int, default=8, help="channels of the autoencoder at full resolution")
    p.add_argument("--z", type=int, default=4, help="latent channels of the autoencoder")
    p.add_argument("--dim-mult", type=numbers, default=[1, 2, 4, 4])
    p.add_argument("--temporal", type=lambda t: [bool(n) for n in numbers(t)], default=[False, True, True])
    p.add_argument("--res-blocks", type=int, default=2)
    p.add_argument("--height", type=int, default=40)
    p.add_argument("--width", type=int, default=56)
    p.add_argument("--heads", type=int, default=3)
    p.add_argument("--head-dim", type=int, default=20)
    p.add_argument("--ffn", type=int, default=72)
    p.add_argument("--layers", type=int, default=3)
    p.add_argument("--text-dim", type=int, default=20)
    p.add_argument("--freq-dim", type=int, default=24)
    p.add_argument("--channels", type=int, default=6, help="latent channels of the transformer")
    p.add_argument("--frames", type=int, default=3)
    p.add_argument("--rows", type=int, default=10)
    p.add_argument("--columns", type=int, default=14)
    p.add_argument("--words", type=int, default=5)
    p.add_argument("--vace-layers", type=numbers, default=[0, 2])
    p.add_argument("--vace-channels", type=int, default=18)
    a = p.parse_args()
    torch.set_num_threads(1)
    a.folder.mkdir(parents=True, exist_ok=True)
    with torch.no_grad():
        vae(a.folder, a)
        dit(a.folder, a)
        vace(a.folder, a)


if __name__ == "__main__":
    main()
