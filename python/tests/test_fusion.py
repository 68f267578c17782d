"""The fusion network in PyTorch is the one of the program: outputs, pictures, losses, gradients and files agree."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import renderflow as rf
from renderflow import _renderflow as native

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from renderflow.fusion import Batch, Batches, Fusion, LossWeights, Sequence, loss, prefetch, psnr, sequence_files  # noqa: E402
from renderflow.fusion.batches import TIERS  # noqa: E402

SCRIPT = Path(__file__).parents[1] / "examples" / "train_fusion.py"
# Largest difference relative to the largest value.
TOLERANCE = 1e-5


def command(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-m", "renderflow", *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    """Sequences of 64 x 64 pixels, with every group of inputs if OIDN is there."""
    folder = tmp_path_factory.mktemp("kept")
    training = json.loads((SCRIPT.parent / "keep_sequences.json").read_text())
    training["training"]["steps"] = 2
    training["recipe"] = {"truth_spp": 8, "key_spp": 8, "frames": 1}
    (folder / "make.json").write_text(json.dumps(training))
    plan = folder / "plan.json"
    command("dataset", "plan", "--seed", "5", "--sequences", "4", "--frames", "18", "--resolution", "64", "--out", plan)
    command("train", "--config", folder / "make.json", "--plan", plan, "--keep", folder / "kept", "--out", folder / "made")
    return folder / "kept"


@pytest.fixture(scope="module")
def sequences(kept) -> list[Sequence]:
    return [Sequence(os.fspath(file)) for file in sequence_files(kept)]


def shipped() -> Fusion:
    return Fusion.shipped()


def noisy() -> Fusion:
    """Random weights, none of which is 0."""
    model = Fusion((16, 32, 16, 48), seed=3, refines=(1, 3, 1, 2), plain_widths=(32, 16, 16, 16))
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for value in model.parameters():
            value += 0.05 * torch.randn(value.shape, generator=generator)
    return model


def drawn(sequences, tier: str, items: int = 2, number: int = 0, size: int = 48) -> native.Batch:
    try:
        return native.draw(sequences, [tier], size, items, 7, number)
    except rf.Error:
        assert tier.startswith("denoised") and rf.denoiser() is None
        pytest.skip("OIDN is not installed: there is no denoised picture")


def difference(ours: torch.Tensor, theirs: np.ndarray) -> float:
    """Largest difference, relative to the largest value."""
    ours = ours.detach().numpy()
    assert ours.shape == theirs.shape
    return np.abs(ours - theirs).max() / np.abs(theirs).max()


@pytest.mark.parametrize("network", [shipped, noisy])
@pytest.mark.parametrize("tier", TIERS)
def test_outputs_and_pictures_are_those_of_the_program(sequences, network, tier):
    model, raw = network(), drawn(sequences, tier)
    fine, coarse, pictures = model._native().outputs(raw)
    batch = Batch.of(raw)
    with torch.no_grad():
        ours, picture = model.outputs(batch), model(batch)
    assert batch.tier == tier and (coarse is None) == (not batch.groups.samples)
    found = [difference(ours.fine, fine), difference(picture, pictures)]
    if coarse is not None:
        found.append(difference(ours.coarse, coarse))
    print(f"{network.__name__} {tier}: " + ", ".join(f"{value:.1e}" for value in found))
    assert max(found) <= TOLERANCE, found
    assert pictures.std() > 0.01


def errors_of_gradients(model: Fusion, raw: native.Batch, weights: LossWeights) -> dict[str, float]:
    """The largest difference of each parameter's gradient, relative to the largest gradient; and that of the loss, relative."""
    total, gradients = model._native().gradients(raw, list(weights))
    # The program sums thousands of pixels in single precision; double precision here leaves only its rounding.
    model, batch = model.double(), Batch.of(raw).to(torch.float64)
    ours = loss(model(batch), batch, weights).total.mean()
    ours.backward()
    largest = max(np.abs(gradient).max() for gradient in gradients.values())
    errors = {"loss": abs(ours.item() / total - 1)}
    for name, value in model.named_parameters():
        grad = torch.zeros_like(value) if value.grad is None else value.grad
        grad = grad.permute(2, 3, 1, 0) if grad.ndim == 4 else grad
        errors[name] = np.abs(grad.numpy() - gradients[name]).max() / largest
    return errors


@pytest.mark.parametrize("network", [shipped, noisy])
@pytest.mark.parametrize("tier", TIERS)
def test_the_loss_and_its_gradients_are_those_of_the_program(sequences, network, tier):
    raw = drawn(sequences, tier, number=1)
    smooth = errors_of_gradients(network(), raw, LossWeights(psnr=0.02, display=0.5, log=0.0, gradient=0.0))
    errors = errors_of_gradients(network(), raw, LossWeights())
    print(f"{network.__name__} {tier}: smooth {max(smooth.values()):.1e}, loss {errors['loss']:.1e}, all {max(errors.values()):.1e}")
    # The large activations of random weights cancel in sums over all pixels, where single precision loses a digit.
    assert max(smooth.values()) <= (TOLERANCE if network is shipped else 5e-5), max(smooth, key=smooth.get)
    assert errors["loss"] <= TOLERANCE
    # An absolute error has a corner at 0: where rounding moves one of thousands across it, its slope has the other sign.
    assert max(errors.values()) <= 3e-3, max(errors, key=errors.get)


def test_whole_frames_of_any_size_are_those_of_the_program(sequences):
    model = shipped()
    sequence = sequences[0]
    frame = len(sequence) - 1
    width, height = sequence.sizes[frame]
    variants = sequence.variants(frame)
    assert "deferred+keys" in variants and "rays 1" in variants
    for variant in variants:
        theirs = model._native().picture(sequence, frame, variant)
        batch = Batch.whole(sequence, frame, variant)
        with torch.no_grad():
            ours = model(batch)[:, :height, :width]
        assert difference(ours[0], theirs) <= TOLERANCE, variant
        truth, alpha = batch.raw[:, :height, :width], batch.alpha[:, :height, :width]
        assert 5 < psnr(ours, truth, alpha).item() < 60
    with pytest.raises(ValueError, match="cannot be rendered"):
        sequence.whole(frame, "magic")
    with pytest.raises(IndexError):
        sequence.whole(99, "deferred")


def test_weights_go_back_to_the_program(tmp_path):
    model = shipped()
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    model.save(first)
    Fusion.load(first).save(second)
    assert first.read_bytes() == second.read_bytes()
    built_in = Path(__file__).parents[2] / "model" / "weights" / "fusion.safetensors"
    assert first.read_bytes() == built_in.read_bytes()
    again = Fusion.load(first)
    assert (again.widths, again.steps, again.seed) == (model.widths, model.steps, model.seed)
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), again.parameters(), strict=True))

    other = noisy()
    other.steps = 17
    other.save(first, half=False)
    exact = Fusion.load(first)
    assert all(torch.equal(a, b) for a, b in zip(other.parameters(), exact.parameters(), strict=True))
    assert (exact.steps, exact.widths, exact.refines) == (17, (16, 32, 16, 48), (1, 3, 1, 2))
    assert exact.plain_widths == (32, 16, 16, 16)
    command("weights", "inspect", first)
    picture = rf.Neural(first).render(rf.compose(seed=7, resolution=64))
    assert np.isfinite(picture).all()

    with torch.no_grad():
        other.sampled.stem.bias[0] = float("nan")
    with pytest.raises(rf.Error, match="sampled.stem.bias"):
        other.save(first)
    with pytest.raises(rf.Error):
        Fusion.load(__file__)
    with pytest.raises(rf.Error, match="widths"):
        Fusion((10, 16, 16, 16))


def test_batches_depend_on_seed_step_and_rank_alone(kept):
    def inputs(step, **options):
        return Batches(kept, tiers=["rays"], **options).at(step, 32, 2).input

    plain = inputs(3)
    assert torch.equal(plain, inputs(3))
    assert not torch.equal(plain, inputs(4)) and not torch.equal(plain, inputs(3, seed=2))
    ranks = [Batches(kept, tiers=["rays"], rank=rank, world=2) for rank in (0, 1)]
    assert sorted(ranks[0].files + ranks[1].files) == sequence_files(kept)
    assert not torch.equal(ranks[0].at(3, 32, 2).input, ranks[1].at(3, 32, 2).input)

    # With a small window, a run that begins later has the same batches.
    early, late = (Batches(kept, tiers=["rays"], window=1, rotate_steps=2) for _ in range(2))
    for step in range(7):
        last = early.at(step, 32, 1)
    assert torch.equal(last.input, late.at(6, 32, 1).input)
    ahead = [batch.input for batch in prefetch(lambda step: late.at(step, 32, 1), range(6, 8))]
    assert len(ahead) == 2 and torch.equal(ahead[0], last.input)


def test_wrong_arguments_are_named(kept, tmp_path):
    with pytest.raises(ValueError, match="'magic' is none of"):
        Batches(kept, tiers=["magic"])
    with pytest.raises(ValueError, match="multiples of 16"):
        Batches(kept).at(0, 20, 1)
    with pytest.raises(rf.Error, match="at least 128 pixels"):
        Batches(kept).at(0, 128, 1)
    with pytest.raises(FileNotFoundError, match="holds no sequences"):
        Batches(tmp_path)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "000000.safetensors").write_bytes(b"{}")
    with pytest.raises(ValueError, match=r"choose one of .*a \(1\)"):
        Batches(tmp_path)
    with pytest.raises(rf.Error, match="000000"):
        Batches(tmp_path / "a").at(0, 32, 1)
    with pytest.raises(RuntimeError, match="of a step"):
        next(prefetch(_fail, range(3)))


def _fail(step):
    raise RuntimeError(f"of a step: {step}")


def _half(rank, folder, raw_arguments):
    """The gradients of one process for its half of a batch."""
    from torch.nn.parallel import DistributedDataParallel

    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    model = noisy()
    parallel = DistributedDataParallel(model, find_unused_parameters=True)
    batch = Batch.of(drawn(*raw_arguments(folder)))[2 * rank : 2 * rank + 2]
    loss(parallel(batch), batch).total.mean().backward()
    if rank == 0:
        torch.save({name: value.grad for name, value in model.named_parameters()}, folder / "gradients.pt")
    torch.distributed.destroy_process_group()


def _four_crops(folder):
    files = (folder / "files").read_text().splitlines()
    return [Sequence(file) for file in files], (folder / "tier").read_text(), 4


@pytest.mark.parametrize("tier", ["rays+around+keys", "deferred"])
def test_two_processes_have_the_gradients_of_one(kept, tmp_path, tier):
    (tmp_path / "files").write_text("\n".join(map(str, sequence_files(kept))))
    (tmp_path / "tier").write_text(tier)
    torch.multiprocessing.spawn(_half, (tmp_path, _four_crops), nprocs=2)
    model, batch = noisy(), Batch.of(drawn(*_four_crops(tmp_path)))
    loss(model(batch), batch).total.mean().backward()
    halves = torch.load(tmp_path / "gradients.pt")
    for name, value in model.named_parameters():
        if value.grad is None:
            assert halves[name] is None or not halves[name].any(), name
        else:
            torch.testing.assert_close(halves[name], value.grad, rtol=1e-4, atol=1e-6)


def run(kept, out, *extra: str, processes: int = 2, **options) -> subprocess.Popen:
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes), str(SCRIPT)]
    small = "--widths 16 16 16 16 --crops 32x2 48x1@0.5 --window 1 --rotate-steps 3 --log-steps 1 --warmup-steps 2".split()
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    command = [*torchrun, str(kept), "--out", str(out), *small, *extra]
    return subprocess.Popen(command, env=environment, **pipes, **options)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_the_script_trains_stops_and_continues(kept, tmp_path):
    steps = ["--steps", "40", "--checkpoint-steps", "15", "--validate", str(kept)]
    whole = run(kept, tmp_path / "whole", *steps)
    text, _ = whole.communicate(timeout=600)
    assert whole.returncode == 0, text
    assert "validation after step 15" in text and "step 40/40" in text and "left 00:00:00" in text

    process = run(kept, tmp_path / "run", *steps)
    for line in process.stdout:
        if re.search(r"step +7/40", line):
            process.send_signal(signal.SIGINT)
            break
    text, _ = process.communicate(timeout=600)
    stopped = re.search(r"stopped after step (\d+)", text)
    assert process.returncode != 0 and stopped, text
    assert 7 <= int(stopped[1]) < 40
    # The weights of a stopped run are usable.
    assert Fusion.load(tmp_path / "run" / "weights.safetensors").steps == int(stopped[1])
    # A disk was full in the middle of a line.
    with (tmp_path / "run" / "log.jsonl").open("a") as log:
        log.write('{"step": 7, "sha')

    again = run(kept, tmp_path / "run", *steps)
    text, _ = again.communicate(timeout=600)
    assert again.returncode == 0 and f"continues after step {stopped[1]}" in text, text
    ours, theirs = (Fusion.load(tmp_path / name / "weights.safetensors") for name in ("run", "whole"))
    assert ours.steps == theirs.steps == 40
    for (name, a), b in zip(ours.named_parameters(), theirs.parameters()):
        assert torch.equal(a, b), name
    logs = [[json.loads(line)["step"] for line in (tmp_path / name / "log.jsonl").open()] for name in ("run", "whole")]
    assert logs[0] == logs[1] == list(range(1, 41))
    command("weights", "inspect", tmp_path / "run" / "weights.safetensors")

    # Another seed is another run.
    other = subprocess.run(
        [sys.executable, SCRIPT, kept, "--out", tmp_path / "run", "--widths", *["16"] * 4, "--seed", "2"],
        capture_output=True, text=True,
    )  # fmt: skip
    assert other.returncode == 1 and "--seed differs" in other.stderr


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_the_script_refuses_before_it_writes(kept, tmp_path):
    import fcntl

    def refused(*extra) -> str:
        arguments = [kept, "--out", tmp_path / "run", "--widths", *["16"] * 4, "--crops", "32x1", "--steps", "1", *extra]
        done = subprocess.run([sys.executable, SCRIPT, *arguments], capture_output=True, text=True)
        assert done.returncode == 1 and not list((tmp_path / "run").iterdir()), done.stderr
        return done.stderr

    (tmp_path / "run").mkdir()
    held = os.open(tmp_path / "run", os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    assert "another process writes to this folder" in refused()
    # `renderflow train` takes the same lock.
    os.close(held)
    assert "holds no sequences" in refused("--validate", tmp_path / "absent")


def test_a_network_learns_a_batch(sequences):
    model, batch = Fusion((16, 16, 16, 16)), Batch.of(drawn(sequences, "rays+keys"))
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-3)
    losses = []
    for _ in range(150):
        optimizer.zero_grad()
        found = loss(model(batch), batch).total.mean()
        found.backward()
        optimizer.step()
        losses.append(found.item())
    assert losses[-1] < 0.9 * losses[0]
