"""Measures what a pilot of two samples would tell about where the other samples of a denoised picture should go.

usage: spread.py RENDERFLOW DATA WORK        Needs numpy and OpenEXR. DATA: sequences of one frame with many raw samples, as made by
    renderflow dataset plan --seed 949494 --split test --sequences 12 --frames 1 --resolution 128 --spp 1024 --denoise none -o plan.toml
    renderflow dataset render --plan plan.toml -o data        (DATA is data/test)

The logarithm of the squared error of 8 even samples, denoised, is fitted to numbers of blocks of 4 x 4 pixels: on all frames but one, for that
one. Samples are then spread by the root of what the fit says, and the frame is rendered again with this map (--sample-map). Prints PSNR over
covered pixels for even samples, for the map that the program makes, and for fits without and with the pilot. Pilots are filtered within one
surface before their contrast is taken. WORK belongs to one DATA: its finished pictures are not made again.
"""
import pathlib
import subprocess
import sys

import numpy as np
import OpenEXR

SPP, BLOCK = 8, 4
# Fewest and most samples of a block, of their average.
RANGE = (0.25, 8.0)


def channels(path):
    return {name: channel.pixels.astype(np.float32) for name, channel in OpenEXR.File(str(path)).channels().items()}


def display(rgb, exposure):
    v = np.clip(rgb * exposure, 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 1e-9) ** (1 / 2.4) - 0.055)


def render(scene, out, *options):
    if not (out / "frame.0000.exr").is_file():
        command = [program, "render", scene, "--frames", "1", "--resolution", "128", "--no-sheet", "-q", "-o", out, *options]
        subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL)
    return out / "frame.0000.exr"


def mapped(name, frame, counts):
    """The picture with these samples of each pixel, denoised by OIDN and the network."""
    path = work / name / frame["name"]
    file = OpenEXR.File(str(frame["detail"]))
    file.channels()["samples.N"].pixels = counts.astype(np.uint32)
    path.mkdir(parents=True, exist_ok=True)
    OpenEXR.File(file.header(), file.channels()).write(str(path / "map.exr"))
    return render(frame["scene"], path / "out", "--sample-map", path / "map.exr", "--denoise", "neural")


def error(frame, path):
    shown, true = (display(rgb[..., :3], frame["exposure"]) for rgb in (channels(path)["RGBA"], frame["truth"]["RGBA"]))
    return ((shown - true) ** 2).mean(2) * frame["covered"]


def spread(x):
    """Largest less smallest value of the 3 x 3 pixels around each pixel."""
    padded = np.pad(x, 1, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return near.max((2, 3)) - near.min((2, 3))


def blocks(x):
    height, width = x.shape
    return x.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).mean((1, 3))


def pilot(frame):
    """Luminance of a pilot of two samples, over its albedo, averaged over 7 x 7 pixels of one surface."""
    of, seen = frame["truth"], channels(render(frame["scene"], work / "pilot" / frame["name"], "--spp", "2", "--denoise", "none"))
    albedo, normal = of["guide_albedo"] + 0.05, np.stack([of[f"normal.{axis}"] for axis in "XYZ"], 2)
    depth, light = np.log(np.clip(of["depth.Z"], 1e-3, 1e4)), seen["RGBA"][..., :3] / albedo
    light = np.minimum(light, 8 * np.median(light[light > 0]))
    total, weights = np.zeros_like(light), np.zeros_like(depth)
    for dy in range(-3, 4):
        for dx in range(-3, 4):
            there = lambda v: np.roll(v, (dy, dx), (0, 1))
            weight = (there(of["object_id.I"]) == of["object_id.I"]) & (there(of["material_id.I"]) == of["material_id.I"])
            alike = np.exp(-((there(normal) - normal) ** 2).sum(2) / 0.05 - np.abs(there(depth) - depth) / 0.05)
            total, weights = total + (weight * alike)[..., None] * there(light), weights + weight * alike
    return display(total / np.maximum(weights, 1e-6)[..., None] * albedo, frame["exposure"]).mean(2)


def numbers(frame, with_pilot):
    of = frame["truth"]
    normal = sum(spread(of[f"normal.{axis}"]) for axis in "XYZ")
    short = np.abs(of["RGBA"][..., 3] - np.sqrt(sum(of[f"guide_normal.{axis}"] ** 2 for axis in "XYZ")))
    mixed = np.abs(of["guide_albedo"] - of["albedo"]).sum(2)
    texture = sum(spread(of["albedo"][..., c]) for c in range(3))
    logs = [(frame["counts"], 0), (normal, 0.05), (texture, 0.05), (mixed, 0.02), (short, 0.01), (of["material"][..., 0], 0.1)]
    if with_pilot:
        light, contrast = frame["pilot"], spread(frame["pilot"])
        logs += [(contrast, 0.02), (contrast**2, 0.001), (light, 0.05)]
    return np.stack([np.log(blocks(x) + least) for x, least in logs] + [blocks(of["material"][..., 1])], 2)


def fitted(frame, others, with_pilot):
    rows, values = [], []
    for other in others:
        there = blocks(other["covered"]) > 0
        x, y = numbers(other, with_pilot)[there], np.log(blocks(other["error"])[there] + 1e-6)
        rows.append(x - x.mean(0))
        values.append(y - y.mean())
    x, y = np.concatenate(rows), np.concatenate(values)
    weights = np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ y)
    wish = np.exp(0.5 * numbers(frame, with_pilot) @ weights) * (blocks(frame["covered"]) > 0)
    mean, scale = frame["counts"].mean(), 1.0
    counts = lambda: np.clip(scale * wish, RANGE[0] * mean, RANGE[1] * mean)
    for _ in range(60):
        scale *= mean / counts().mean()
    return np.kron(np.maximum(np.round(counts()), 1), np.ones((BLOCK, BLOCK)))


if len(sys.argv) != 4:
    sys.exit(__doc__)
program, data, work = sys.argv[1], pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3])
frames = []
for folder in sorted(data.glob("seq-*")):
    truth, scene = folder / "frame.0000.exr", folder / "scene.json"
    frame = {"name": folder.name, "scene": scene, "truth": channels(truth)}
    frame["exposure"] = float(OpenEXR.File(str(truth)).header()["renderflow/exposure"])
    frame["covered"] = (frame["truth"]["RGBA"][..., 3] > 0).astype(np.float32)
    frame["detail"] = render(scene, work / "detail" / folder.name, "--spp", str(SPP), "--adaptive", "--denoise", "oidn")
    frame["counts"] = channels(frame["detail"])["samples.N"]
    frame["error"] = error(frame, mapped("even", frame, np.full(frame["counts"].shape, SPP)))
    frame["pilot"] = pilot(frame)
    frames.append(frame)
if len(frames) < 2:
    sys.exit(f"{data}: needs two sequences or more")

first = None
for name in ("even", "detail-map", "fit", "fit-with-pilot"):
    found = []
    for frame in frames:
        if name == "even":
            counts = np.full(frame["counts"].shape, SPP)
        elif name == "detail-map":
            counts = frame["counts"]
        else:
            counts = fitted(frame, [other for other in frames if other is not frame], name == "fit-with-pilot")
        found.append(-10 * np.log10(error(frame, mapped(name, frame, counts)).sum() / frame["covered"].sum()))
    first = found if first is None else first
    gains = " ".join(f"{a - b:+.2f}" for a, b in zip(found, first))
    print(f"{name:15s} {np.mean(found):.2f} dB, over even samples {np.mean(found) - np.mean(first):+.2f}: {gains}", flush=True)
