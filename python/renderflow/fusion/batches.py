"""What the network learns from: kept sequences, and batches of random crops of their frames."""

from __future__ import annotations

import dataclasses
import os
import queue
import random
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from .. import _renderflow as _native
from .._renderflow import Sequence

__all__ = ["TIERS", "Batch", "Batches", "Groups", "Sequence", "prefetch", "sequence_files"]

T = TypeVar("T")

# Names of the combinations of inputs that are trained, with their shares of the batches.
TIERS: dict[str, float] = dict(_native.tiers())


class Groups(NamedTuple):
    """The groups of inputs that are given besides the G-buffer."""

    deferred: bool
    """Terms of deferred shading."""
    keys: bool
    """Warped keyframes."""
    samples: bool
    """Traced samples of the frame."""
    neighbours: bool
    """Samples of neighbouring frames."""
    denoised: bool
    """A picture that another denoiser made from the samples."""
    paths: bool
    """What the samples are made of: indirect light, hidden light, and how much they vary."""


@dataclasses.dataclass(frozen=True)
class Batch:
    """What the network, its head and the loss read: float32 tensors with the items, the height and the width first. The sides
    are multiples of 16. Radiance is exposed and linear. Tensors of groups that are not given are ``None``."""

    tier: str
    """Name of the combination of inputs."""
    groups: Groups
    """Which groups are given."""
    input: Tensor
    """Input of the U-Net, (items, height/2, width/2, channels)."""
    alpha: Tensor
    """Coverage, (items, height, width)."""
    background: Tensor
    """Environment behind the pixel, (.., 3)."""
    tint: Tensor
    """Reflectance by which filtered samples are multiplied, (.., 3)."""
    truth: Tensor
    """True radiance, denoised where OIDN was found, (.., 3)."""
    raw: Tensor
    """The same before it was denoised, (.., 3)."""
    terms: Tensor | None = None
    """Terms of deferred shading: lights, diffuse sky, reflections, bounced light, (.., 4, 3)."""
    keys: Tensor | None = None
    """Warped keyframes, (.., 2, 3)."""
    trust: Tensor | None = None
    """Logarithm of each keyframe's weight before training, (.., 2); minus infinity where it shows nothing."""
    own: Tensor | None = None
    """Samples divided by the reflectance, and their coverage, times their number, (.., 4)."""
    paths: Tensor | None = None
    """What the samples are made of: indirect and hidden light as ``own``, and the standard deviation of one sample, (.., 9)."""
    reflected: Tensor | None = None
    """Unoccluded specular reflection of the environment, (.., 3)."""
    others: Tensor | None = None
    """As ``own`` for each neighbour, (.., 4, 4)."""
    others_indirect: Tensor | None = None
    """The part of them that is indirect light, where ``paths`` is given, (.., 4, 3)."""
    denoised: Tensor | None = None
    """Radiance of the surface in the denoised picture, (.., 3)."""

    @classmethod
    def of(cls, native: _native.Batch) -> Batch:
        """The batch that the compiled part made."""
        tensors = {name: torch.from_numpy(array) for name, array in native.arrays().items()}
        return cls(native.tier, Groups(*native.groups), **tensors)

    @classmethod
    def whole(cls, sequence: Sequence, frame: int, variant: str) -> Batch:
        """A whole frame of a sequence from the inputs ``variant``, one of ``sequence.variants(frame)``.

        Its last row and column are repeated up to a multiple of 16: crop pictures to ``sequence.sizes[frame]``.
        """
        return cls.of(sequence.whole(frame, variant))

    def to(self, *arguments, **options) -> Batch:
        """The batch with every tensor's ``to``."""
        return self._each(lambda tensor: tensor.to(*arguments, **options))

    def pin_memory(self) -> Batch:
        """The batch in memory from which copies to a GPU need not wait."""
        return self._each(Tensor.pin_memory)

    def __getitem__(self, items: slice) -> Batch:
        """Some of the items."""
        return self._each(lambda tensor: tensor[items])

    def __len__(self) -> int:
        return len(self.alpha)

    def _each(self, change: Callable[[Tensor], Tensor]) -> Batch:
        tensors = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return dataclasses.replace(self, **{name: change(v) for name, v in tensors.items() if isinstance(v, Tensor)})


def sequence_files(folder: str | os.PathLike[str]) -> list[Path]:
    """The files of the sequences that ``renderflow train --keep FOLDER`` keeps, in order.

    A run keeps its training sequences and those of its validation in folders of their own inside ``FOLDER``. Where there are
    several, ``folder`` must be one of them: else ``ValueError`` lists them. ``FileNotFoundError`` where there is no sequence.
    """
    folder = Path(folder)
    found = {place: sorted(place.glob("*.safetensors")) for place in (folder, *sorted(folder.glob("*/")))}
    found = {place: files for place, files in found.items() if files}
    if not found:
        raise FileNotFoundError(f"{folder}: holds no sequences; renderflow train --keep {folder} makes some")
    if folder not in found and len(found) > 1:
        listed = ", ".join(f"{place} ({len(files)})" for place, files in found.items())
        raise ValueError(f"{folder}: holds sequences of several kinds; choose one of {listed}")
    return found.get(folder) or next(iter(found.values()))


class Batches:
    """Batches of random crops, each determined by the seed, the step, the rank and the files alone.

    At most ``window`` sequences are in memory, about 18 MB for each frame of 256 x 256 pixels. Where there are more, the oldest
    is replaced every ``rotate_steps`` steps by the next one of an endless shuffled order. ``tiers`` names the combinations of
    inputs that are drawn (:data:`TIERS`); empty for all but ``deferred+keys``, since ``renderflow`` carries keyframes over what
    the network makes without them. With ``world`` processes, each reads its own share of the sequences (all of them where there
    are fewer than processes) and draws its own crops.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        seed: int = 1,
        tiers: Iterable[str] = (),
        window: int = 32,
        rotate_steps: int = 100,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        if not 0 <= rank < world:
            raise ValueError(f"rank {rank} of {world} processes")
        if window < 1 or rotate_steps < 1:
            raise ValueError(f"window {window} and rotate_steps {rotate_steps} must be at least 1")
        self.tiers = list(tiers)
        unknown = [tier for tier in self.tiers if tier not in TIERS]
        if unknown:
            raise ValueError(f"tiers: {unknown[0]!r} is none of {', '.join(TIERS)}")
        files = sequence_files(folder)
        self.files = files[rank::world] if len(files) >= world else files
        self.seed, self.window, self.rotate_steps = seed, min(window, len(self.files)), rotate_steps
        self.rank, self.world = rank, world
        self._held: dict[int, Sequence] = {}

    def at(self, step: int, size: int, items: int) -> Batch:
        """The batch of a step: ``items`` crops of ``size`` x ``size`` pixels, a multiple of 16.

        Raises :class:`renderflow.Error` where a file cannot be read, or where no frame of this size has the inputs of a tier.
        """
        return Batch.of(self._draw(step, size, items))

    def _draw(self, step: int, size: int, items: int) -> _native.Batch:
        first = step // self.rotate_steps if self.window < len(self.files) else 0
        wanted = range(first, first + self.window)
        self._held = {i: sequence for i, sequence in self._held.items() if i in wanted}
        for i in wanted:
            if i not in self._held:
                self._held[i] = Sequence(os.fspath(self._file(i)))
        held = [self._held[i] for i in wanted]
        return _native.draw(held, self.tiers, size, items, self.seed, step * self.world + self.rank)

    def _file(self, position: int) -> Path:
        """The file at a position of the endless order: one shuffled order of all files after another."""
        turn, place = divmod(position, len(self.files))
        order = list(self.files)
        random.Random(f"{self.seed} {turn} {self.rank}").shuffle(order)
        return order[place]


def prefetch(make: Callable[[int], T], steps: Iterable[int], ahead: int = 2) -> Iterator[T]:
    """Calls ``make`` for one step after another in a thread of its own, up to ``ahead`` steps early. Its exceptions are raised
    here."""
    made: queue.Queue[tuple[T | None, BaseException | None]] = queue.Queue(ahead)
    stopped = threading.Event()

    def put(result: T | None, error: BaseException | None) -> None:
        while not stopped.is_set():
            try:
                return made.put((result, error), timeout=0.1)
            except queue.Full:
                continue

    def work() -> None:
        try:
            for step in steps:
                if stopped.is_set():
                    return
                put(make(step), None)
            put(None, StopIteration())
        except BaseException as error:
            put(None, error)

    threading.Thread(target=work, daemon=True).start()
    try:
        while True:
            result, error = made.get()
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            yield result
    finally:
        stopped.set()
