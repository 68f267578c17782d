"""Trains the fusion network in PyTorch, on one process or with torchrun on several.

    renderflow dataset plan --seed 5 --sequences 250 --frames 34 --resolution 256 --out plan.json
    renderflow train --config keep_sequences.json --plan plan.json --keep kept --out made
    torchrun --nproc-per-node 2 train_fusion.py kept --out run --steps 20000
    renderflow infer --data data/test --weights run/weights.safetensors --out pictures

The folder `kept` holds the rendered sequences, one file each, which are dealt out to the processes. The output folder gets
`weights.safetensors` (the averaged weights, which the program reads), `checkpoint.pt` and `log.jsonl`. The same command continues
a run that was stopped. Ctrl-C and SIGTERM stop it after the current step, with a checkpoint and exit code 75. One run at a time
writes to an output folder.
"""

from __future__ import annotations

import argparse
import copy
import fcntl
import json
import math
import os
import signal
import sys
import time
import warnings
from pathlib import Path

import torch
import torch.distributed as dist
from renderflow.fusion import Batch, Batches, Fusion, LossWeights, Sequence, loss, prefetch, psnr, sequence_files
from renderflow.fusion.batches import TIERS
from renderflow.fusion.network import WIDTHS
from torch.nn.parallel import DistributedDataParallel

INTERRUPTED = 75
# Number of steps in a row whose gradient may be infinite or NaN. They are left out.
MOST_LEFT_OUT = 10
# The learning rate at the end, relative to the peak.
FLOOR = 0.01


def crop(text: str) -> tuple[int, int, float]:
    """SIZExITEMS or SIZExITEMS@SHARE"""
    try:
        shape, _, share = text.partition("@")
        size, items = (int(number) for number in shape.split("x"))
        made = size, items, float(share or 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form 96x8 or 192x2@0.67") from None
    if size < 16 or size % 16 or items < 1 or not 0 <= made[2] < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: the size must be a multiple of 16, and the share in 0..1")
    return made


def options(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n\n")[0],
        epilog="\n\n".join(__doc__.strip().split("\n\n")[1:]),
        formatter_class=lambda prog: _Help(prog, width=120),
    )
    parser.add_argument("sequences", help="folder of sequences that `renderflow train --keep` wrote")
    parser.add_argument("--out", type=Path, required=True, help="output folder")
    parser.add_argument("--validate", help="folder of sequences whose last frames the averaged weights are validated on")
    group = parser.add_argument_group("network")
    group.add_argument("--widths", type=int, nargs=4, help="channels of the four levels (48 64 96 128, or those of --from)")
    group.add_argument("--from", dest="start", type=Path, help="weights to begin with; `shipped` for those in the program")
    group.add_argument("--seed", type=int, default=1, help="seed of the initial weights and of the crops")
    group = parser.add_argument_group("optimisation")
    group.add_argument("--steps", type=int, default=20_000, help="steps in all")
    group.add_argument("--lr", type=float, default=3e-4, help="peak learning rate of AdamW")
    group.add_argument("--warmup-steps", type=int, default=200, help="steps over which the rate rises; then it follows a cosine")
    group.add_argument("--weight-decay", type=float, default=0.01, help="of kernels; biases have none")
    group.add_argument("--clip-norm", type=float, default=1.0, help="largest norm of the gradient")
    group.add_argument("--ema-decay", type=float, default=0.999, help="decay of the averaged weights")
    group = parser.add_argument_group("data")
    group.add_argument(
        "--crops", type=crop, nargs="+", default=[(96, 8, 0.0), (192, 2, 0.67)], metavar="SIZExITEMS[@SHARE]",
        help="crops of one process in a step, and the share of the run from which on they are drawn (96x8 192x2@0.67)",
    )  # fmt: skip
    group.add_argument("--tiers", nargs="+", default=[], choices=list(TIERS), metavar="TIER", help=f"of {', '.join(TIERS)}")
    group.add_argument("--window", type=int, default=32, help="sequences in the memory of a process")
    group.add_argument("--rotate-steps", type=int, default=100, help="steps after which one of them is replaced")
    group = parser.add_argument_group("run")
    group.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to train")
    group.add_argument("--precision", default="f32", choices=["f32", "bf16"], help="of the convolutions")
    group.add_argument("--checkpoint-steps", type=int, default=500, help="steps between checkpoints")
    group.add_argument("--log-steps", type=int, default=20, help="steps between lines of progress")
    given = parser.parse_args(arguments)
    if all(share > 0 for *_, share in given.crops):
        parser.error("--crops: one kind of crop must begin at 0")
    if min(given.steps, given.checkpoint_steps, given.log_steps) < 1:
        parser.error("--steps, --checkpoint-steps and --log-steps must be at least 1")
    return given


class _Help(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    pass


def learning_rate(given: argparse.Namespace, step: int) -> float:
    """A linear warm-up, then half a cosine down to 1 %."""
    warm = min(1.0, (step + 1) / max(1, given.warmup_steps))
    cosine = 0.5 * (1 + math.cos(math.pi * min(1.0, step / given.steps)))
    return given.lr * warm * (FLOOR + (1 - FLOOR) * cosine)


class Processes:
    """The processes of the run: one, or those that torchrun started."""

    def __init__(self, device: str) -> None:
        cuda = device == "cuda" or (device == "auto" and torch.cuda.is_available())
        self.rank, self.world = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
        local = int(os.environ.get("LOCAL_RANK", "0"))
        self.device = torch.device("cuda", local) if cuda else torch.device("cpu")
        if cuda:
            torch.cuda.set_device(self.device)
        if self.world > 1:
            dist.init_process_group("nccl" if cuda else "gloo")

    def sum(self, values: list[float]) -> list[float]:
        """The sums of values over the processes."""
        total = torch.tensor(values, dtype=torch.float64, device=self.device)
        if self.world > 1:
            dist.all_reduce(total)
        return total.tolist()

    def say(self, text: str) -> None:
        if self.rank == 0:
            print(text, flush=True)

    def close(self) -> None:
        if self.world > 1:
            dist.destroy_process_group()


def hold(folder: Path) -> None:
    """Keeps other runs from a folder until this process ends. `renderflow train` locks it in the same way."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        sys.exit(f"{folder}: another process writes to this folder; wait for its end, or choose another folder")
    except OSError:
        # Some network file systems have no locks.
        os.close(descriptor)


class Run:
    """The state of a run, which a checkpoint holds."""

    def __init__(self, given: argparse.Namespace, processes: Processes) -> None:
        self.given, self.processes = given, processes
        self.checkpoint = given.out / "checkpoint.pt"
        self.step, self.elapsed = 0, 0.0
        if given.start is None:
            model = Fusion(given.widths or WIDTHS, given.seed)
        else:
            model = Fusion.shipped() if str(given.start) == "shipped" else Fusion.load(given.start)
            if given.widths not in (None, list(model.widths)):
                sys.exit(f"--from {given.start}: has the widths {' '.join(map(str, model.widths))}; pass no other --widths")
        given.widths = list(model.widths)
        self.model = model.to(processes.device)
        self.average = copy.deepcopy(self.model).requires_grad_(False)
        kernels = [p for p in self.model.parameters() if p.ndim > 1]
        biases = [p for p in self.model.parameters() if p.ndim == 1]
        groups = [{"params": kernels, "weight_decay": given.weight_decay}, {"params": biases, "weight_decay": 0.0}]
        self.optimizer = torch.optim.AdamW(groups, lr=given.lr, betas=(0.9, 0.99), eps=1e-8)
        self._resume()

    def _resume(self) -> None:
        given = self.given
        if not self.checkpoint.exists():
            if (given.out / "weights.safetensors").exists():
                sys.exit(f"{given.out}: holds weights, but no checkpoint of this run; choose another output folder")
            return
        stored = torch.load(self.checkpoint, map_location=self.processes.device, weights_only=True)
        for name in ("widths", "seed"):
            if stored[name] != getattr(given, name):
                sys.exit(f"--{name} differs from the run in {self.checkpoint}; choose another output folder")
        if stored.get("paths", False) != self.model.paths:
            sys.exit(f"{self.checkpoint}: is of a network that reads other inputs; choose another output folder")
        if stored["world"] != self.processes.world:
            self.processes.say(f"the run had {stored['world']} processes before: from here on its batches are others")
        self.model.load_state_dict(stored["model"])
        self.average.load_state_dict(stored["average"])
        self.optimizer.load_state_dict(stored["optimizer"])
        self.step, self.elapsed = stored["step"], stored["elapsed"]
        self.processes.say(f"continues after step {self.step}")

    def save(self) -> None:
        """Writes the checkpoint and the averaged weights, each beside its place first."""
        if self.processes.rank > 0:
            return
        given = self.given
        state = {
            "widths": given.widths,
            "seed": given.seed,
            "paths": self.model.paths,
            "world": self.processes.world,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "elapsed": self.elapsed,
        }
        draft = self.checkpoint.with_suffix(".tmp")
        torch.save(state, draft)
        os.replace(draft, self.checkpoint)
        self.average.steps, self.average.seed = self.step, given.seed
        self.average.save(given.out / "weights.safetensors")

    def update(self) -> float:
        """Takes a step along the gradient, and returns its norm. A gradient that is not finite changes nothing."""
        given = self.given
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), given.clip_norm).item()
        rate = learning_rate(given, self.step)
        self.step += 1
        if not math.isfinite(norm):
            return norm
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.step()
        # The memory is short at first, so that the average forgets the random start.
        decay = min(given.ema_decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for average, value in zip(self.average.parameters(), self.model.parameters()):
                average.lerp_(value, 1 - decay)
        return norm


def step_of(line: str) -> float:
    """The step of a line of the log; infinite where it is no whole line."""
    try:
        return json.loads(line)["step"]
    except ValueError:
        return math.inf


class Log:
    """Sums since the last line, and the lines."""

    def __init__(self, run: Run) -> None:
        self.run, self.path = run, run.given.out / "log.jsonl"
        self.first, self.start, self.before = run.step, time.monotonic(), run.elapsed
        self._clear()
        if run.processes.rank == 0 and self.path.exists():
            # A run that was killed has lines of steps that are taken once more, and one that met a full disk has half a line.
            lines = [line for line in self.path.read_text().splitlines() if step_of(line) <= run.step]
            self.path.write_text("".join(line + "\n" for line in lines))

    def _clear(self) -> None:
        self.since, self.steps, self.items, self.loss, self.norm = time.monotonic(), 0, 0, 0.0, 0.0
        self.squares = {tier: [0.0, 0.0] for tier in TIERS}

    def add(self, items: int, sums: list[float], norm: float) -> None:
        """Adds a step: the losses of all processes, then for each tier the sum of squares and the number of batches."""
        self.steps, self.items = self.steps + 1, self.items + items
        self.loss += sums[0] / self.run.processes.world
        self.norm += norm
        for kept, new in zip(self.squares.values(), zip(sums[1::2], sums[2::2])):
            kept[0] += new[0]
            kept[1] += new[1]

    def tick(self) -> None:
        run, given, now = self.run, self.run.given, time.monotonic()
        run.elapsed = self.before + now - self.start
        if run.step % given.log_steps and run.step != given.steps:
            return
        eta = (now - self.start) / max(1, run.step - self.first) * (given.steps - run.step)
        n = max(1, self.steps)
        line = {
            "step": run.step,
            "share": run.step / given.steps,
            "loss": self.loss / n,
            "psnr": {tier: -10 * math.log10(max(s / c, 1e-10)) for tier, (s, c) in self.squares.items() if c},
            "gradient_norm": self.norm / n,
            "lr": learning_rate(given, run.step - 1),
            "items_per_second": self.items / max(1e-9, now - self.since),
            "elapsed": run.elapsed,
            "eta": eta,
        }
        self._clear()
        if run.processes.rank > 0:
            return
        with self.path.open("a") as file:
            file.write(json.dumps(line) + "\n")
        listed = ", ".join(f"{tier} {value:.2f}" for tier, value in line["psnr"].items())
        width, left = len(str(given.steps)), time.strftime("%H:%M:%S", time.gmtime(eta % 86400))
        left = f"{int(eta // 86400)} d {left}" if eta >= 86400 else left
        run.processes.say(
            f"step {run.step:{width}}/{given.steps}  loss {line['loss']:.4f}  {line['items_per_second']:.1f} crops/s  "
            f"left {left}  dB: {listed}"
        )


def validate(run: Run) -> None:
    """Prints the mean PSNR of the averaged weights for each kind of input. The frames are dealt out to the processes."""
    processes, given = run.processes, run.given
    sums: dict[str, list[float]] = {}
    for place, file in enumerate(sequence_files(given.validate)):
        sequence = Sequence(os.fspath(file))
        frame = len(sequence) - 1
        width, height = sequence.sizes[frame]
        for variant in sequence.variants(frame):
            kept = sums.setdefault(variant, [0.0, 0.0])
            if place % processes.world == processes.rank:
                batch = Batch.whole(sequence, frame, variant).to(processes.device)
                with torch.no_grad():
                    picture = run.average(batch)[:, :height, :width]
                kept[0] += psnr(picture, batch.raw[:, :height, :width], batch.alpha[:, :height, :width]).item()
                kept[1] += 1
    flat = processes.sum([value for pair in sums.values() for value in pair])
    means = {name: flat[2 * i] / flat[2 * i + 1] for i, name in enumerate(sums)}
    if processes.rank == 0:
        with (given.out / "validation.jsonl").open("a") as file:
            file.write(json.dumps({"step": run.step, "psnr": means}) + "\n")
    processes.say(f"validation after step {run.step}: " + ", ".join(f"{name} {value:.2f}" for name, value in means.items()))


def train(run: Run, stopped: list[int]) -> bool:
    """Trains to the end, and returns whether it was reached."""
    given, processes = run.given, run.processes
    if given.validate:
        # A wrong folder is refused now, and not after the first checkpoint.
        sequence_files(given.validate)
    batches = Batches(
        given.sequences,
        seed=given.seed,
        tiers=given.tiers,
        window=given.window,
        rotate_steps=given.rotate_steps,
        rank=processes.rank,
        world=processes.world,
    )
    processes.say(f"{processes.world} processes on {processes.device.type}, each with {len(batches.files)} sequences")

    def make(step: int) -> Batch:
        begun = [kind for kind in given.crops if kind[2] <= step / given.steps]
        size, items, _ = max(begun, key=lambda kind: kind[2])
        batch = batches.at(step, size, items)
        return batch.pin_memory() if processes.device.type == "cuda" else batch

    # Kernels of one pixel have strides of two layouts, between which nothing is lost.
    warnings.filterwarnings("ignore", message="Grad strides do not match")
    # A batch without samples has no use for the coarse kernels. PyTorch warns once where the first batch has.
    model = DistributedDataParallel(run.model, find_unused_parameters=True) if processes.world > 1 else run.model
    log, left_out = Log(run), 0
    for batch in prefetch(make, range(run.step, given.steps)):
        batch = batch.to(processes.device, non_blocking=True)
        run.optimizer.zero_grad()
        with torch.autocast(processes.device.type, torch.bfloat16, enabled=given.precision == "bf16"):
            picture = model(batch)
        found = loss(picture, batch, LossWeights())
        found.total.mean().backward()
        norm = run.update()
        left_out = 0 if math.isfinite(norm) else left_out + 1
        squares = [v for tier in TIERS for v in ((found.display.mean().item(), 1.0) if tier == batch.tier else (0.0, 0.0))]
        # All processes stop after the same step.
        stop, *sums = processes.sum([float(bool(stopped)), found.total.mean().item(), *squares])
        if left_out:
            processes.say(f"step {run.step}: the gradient is not finite; the step is left out")
            if left_out > MOST_LEFT_OUT:
                raise SystemExit(f"the gradients of {left_out} steps in a row are not finite; lower the learning rate")
        else:
            log.add(processes.world * len(batch), sums, norm)
        log.tick()
        if stop:
            break
        if run.step % given.checkpoint_steps == 0 and run.step < given.steps:
            run.save()
            if given.validate:
                validate(run)
    run.save()
    # torchrun ends the other processes when one has ended, so they wait until the files are written.
    processes.sum([0.0])
    if given.validate and run.step == given.steps:
        validate(run)
    return run.step == given.steps


def main() -> None:
    given = options()
    # torchrun passes a signal on to all processes, so one may come twice.
    stopped: list[int] = []
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda number, _: stopped.append(number))
    given.out.mkdir(parents=True, exist_ok=True)
    processes = Processes(given.device)
    try:
        if processes.rank == 0:
            hold(given.out)
        run = Run(given, processes)
        finished = train(run, stopped)
        weights = given.out / "weights.safetensors"
        if not finished:
            processes.say(f"stopped after step {run.step}; the same command continues")
            sys.exit(INTERRUPTED)
        processes.say(f"done: {run.step} steps in {run.elapsed:.0f} s: {weights}")
    finally:
        processes.close()


if __name__ == "__main__":
    main()
