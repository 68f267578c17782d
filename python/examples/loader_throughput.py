"""Measures how fast datasets come into PyTorch: loader_throughput.py [WORK] [--frames 128] [--resolution 128] [--rounds 5]

It makes a dataset in WORK (or a temporary folder), packs it in both profiles, and reads all of it with: plain reads of the
same files, FrameDataset, ShardDataset, and webdataset with the same decoding. All take turns in every round, so other work on
the machine meets them alike. The table has medians of the rounds. Files lie in the page cache. Needs torch; webdataset is left
out where it is not installed."""

import argparse
import gc
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from renderflow import data, read_frame
from renderflow.torch import LAYERS, FrameDataset, ShardDataset, to_tensors
from torch.utils.data import DataLoader

try:
    import webdataset
except ImportError:
    webdataset = None

PASSES = 4


def renderflow(*arguments):
    subprocess.run([sys.executable, "-m", "renderflow", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def make(work, frames, resolution):
    if not (work / "data").exists():
        plan = ["--seed", 5, "--split", "train", "--sequences", 2, "--frames", frames // 2, "--resolution", resolution]
        renderflow("dataset", "plan", *plan, "--spp", 1, "--denoise", "none", "-o", work / "plan.toml")
        renderflow("dataset", "render", "--plan", work / "plan.toml", "-o", work / "data")
    for profile in ("stored", "compact"):
        if not (work / profile).exists():
            renderflow(
                "dataset",
                "pack",
                work / "data",
                "-o",
                work / profile,
                "--profile",
                profile,
                "--samples-per-shard",
                max(1, frames // 8),
            )


def decode(sample):
    packed = sample["rff"] if "rff" in sample else sample["exr"]
    return {"key": sample["__key__"], **to_tensors(read_frame(packed, LAYERS))}


def theirs(folder):
    """The same frames by webdataset: shuffled shards, a buffer of 256 samples, the same decoding."""
    urls = [str(shard.path) for shard in data.shards(folder)]
    return webdataset.WebDataset(urls, shardshuffle=len(urls), empty_check=False).shuffle(256).map(decode)


def processor():
    """Seconds of processor time of this process and of its children that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def load(dataset, workers, **options):
    """Samples of four passes with batches of eight, by the same workers."""
    loader = DataLoader(dataset, batch_size=8, num_workers=workers, persistent_workers=workers > 0, **options)
    return sum(len(batch["beauty"]) for _ in range(PASSES) for batch in loader)


def plain(paths, frames):
    for path in list(paths) * PASSES:
        with open(path, "rb") as file:
            while file.read(1 << 20):
                pass
    return frames * PASSES


def timed(measure):
    """Seconds of the clock and of the processor."""
    start, busy = time.perf_counter(), processor()
    samples = measure()
    gc.collect()  # Workers end here, and their processor time counts.
    return time.perf_counter() - start, processor() - busy, samples


def contestants(work):
    """Name, files and measurement, in the order of the table."""
    frames = data.Dataset(work / "data", "train").paths
    yield "folder, plain reads", frames, lambda: plain(frames, len(frames))
    for workers in (0, 2):
        yield (
            f"folder, FrameDataset, {workers} workers",
            frames,
            lambda w=workers: load(FrameDataset(work / "data", "train"), w, shuffle=True),
        )
    for profile in ("stored", "compact"):
        folder = work / profile
        shards = [shard.path for shard in data.shards(folder)]
        yield f"{profile} shards, plain reads", shards, lambda s=shards: plain(s, len(frames))
        for workers in (0, 2):
            yield (
                f"{profile} shards, ShardDataset, {workers} workers",
                shards,
                lambda f=folder, w=workers: load(ShardDataset(f), w),
            )
            if webdataset:
                yield f"{profile} shards, webdataset, {workers} workers", shards, lambda f=folder, w=workers: load(theirs(f), w)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", nargs="?", type=Path)
    parser.add_argument("--frames", type=int, default=128)
    parser.add_argument("--resolution", type=int, default=128)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as temporary:
        work = options.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        make(work, options.frames, options.resolution)
        table = list(contestants(work))
        sizes = {name: sum(path.stat().st_size for path in files) / 1e6 for name, files, _ in table}
        seconds, busy = ({name: [] for name, _, _ in table} for _ in range(2))
        for name, _, measure in table:  # The first time reads the files into the page cache and does not count.
            measure()
        for _ in range(options.rounds):
            for name, _, measure in table:
                taken, worked, samples = timed(measure)
                assert samples == PASSES * options.frames, f"{name}: {samples} samples"
                seconds[name].append(taken)
                busy[name].append(worked)
    print("| what | samples/s | MB/s | processor time of a sample | webdataset's / ours: seconds | processor time |")
    print("|---|---|---|---|---|---|")
    for name, _, _ in table:
        passes = statistics.median(seconds[name]) / PASSES
        milliseconds = 1e3 * statistics.median(busy[name]) / (PASSES * options.frames)
        other = name.replace("ShardDataset", "webdataset")
        ratios = [""] * 2
        if other != name and other in seconds:
            ratios = [f"{statistics.median(b / a for a, b in zip(of[name], of[other])):.2f}" for of in (seconds, busy)]
        print(
            f"| {name} | {options.frames / passes:.0f} | {sizes[name] / passes:.0f} | {milliseconds:.2f} ms | {ratios[0]} | {ratios[1]} |"
        )


if __name__ == "__main__":
    main()
