"""PyTorch datasets. Frames become dicts of tensors (components, height, width); ids become int64."""

from __future__ import annotations

import itertools
import os
import random
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from . import Frame, data, read_frame

__all__ = ["FrameDataset", "ShardDataset", "to_tensors"]

LAYERS = ("beauty", "albedo", "normal", "depth", "material")


def to_tensors(frame: Frame) -> dict[str, torch.Tensor]:
    """The layers of a frame as tensors (components, height, width)."""
    return {name: _tensor(values) for name, values in frame.items()}


def _tensor(values: np.ndarray) -> torch.Tensor:
    planes = np.moveaxis(np.atleast_3d(values), -1, 0)
    return torch.from_numpy(np.ascontiguousarray(planes, np.int64 if values.dtype.kind == "u" else None))


class FrameDataset(Dataset[dict[str, Any]]):
    """The frames of a dataset folder, for a ``DataLoader`` with ``shuffle=True`` or a ``DistributedSampler``.

    A sample has the layers, ``exposure``, and ``path``.
    """

    def __init__(self, folder: str | os.PathLike[str], split: str | None = None, layers: Iterable[str] | None = LAYERS) -> None:
        self.frames = data.Dataset(folder, split, layers)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> dict[str, Any]:
        frame = self.frames[index]
        return {"path": str(self.frames.paths[index]), "exposure": frame.exposure, **to_tensors(frame)}


class ShardDataset(IterableDataset[dict[str, Any]]):
    """The frames of packed shards, for a ``DataLoader`` with any number of workers.

    A sample has the layers, ``key``, ``exposure`` and ``keyframe``. With ``shuffle``, the order of the shards changes with every
    epoch (:meth:`set_epoch`), and samples pass through a buffer of ``buffer`` samples from which they are drawn at random: frames
    of one sequence lie side by side in a shard. ``buffer`` should hold several sequences.

    Shards are dealt out to processes (``rank`` of ``world``, by default those of ``torch.distributed``) and then to workers. Every
    process gets the same number of samples, ``len(dataset)``; those beyond it are left out.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        split: str = "train",
        layers: Iterable[str] | None = LAYERS,
        *,
        shuffle: bool = True,
        buffer: int = 256,
        seed: int = 0,
        rank: int | None = None,
        world: int | None = None,
    ) -> None:
        super().__init__()
        self.shards = data.shards(folder, split)
        self.layers = None if layers is None else tuple(layers)
        self.shuffle, self.buffer, self.seed = shuffle, max(1, buffer), seed
        # In shared memory, so that workers that outlive an epoch (``persistent_workers``) see it change.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()
        distributed = torch.distributed.is_available() and torch.distributed.is_initialized()
        self.world = world if world is not None else torch.distributed.get_world_size() if distributed else 1
        self.rank = rank if rank is not None else torch.distributed.get_rank() if distributed else 0
        if not 0 <= self.rank < self.world:
            raise ValueError(f"rank {self.rank} of {self.world} processes")
        if len(self.shards) < self.world:
            raise ValueError(
                f"{len(self.shards)} shards for {self.world} processes: pack with fewer samples per shard (--samples-per-shard)"
            )

    @property
    def epoch(self) -> int:
        """The epoch whose order is read next."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Chooses the order. Call it before each epoch, in every process with the same number."""
        self._epoch.fill_(epoch)

    def __len__(self) -> int:
        return self._least(self._order(self.epoch))

    def __iter__(self) -> Iterator[dict[str, Any]]:
        info = get_worker_info()
        worker, workers = (info.id, info.num_workers) if info else (0, 1)
        epoch = self.epoch
        order = self._order(epoch)
        mine = order[self.rank :: self.world]
        # Every worker makes batches of its own. Their shares depend on the common number of samples alone, so all processes get
        # as many batches.
        least = self._least(order)
        begin, end = (least * part // workers for part in (worker, worker + 1))
        rng = random.Random(f"{self.seed} {epoch} {self.rank} {worker} samples")
        raw = itertools.islice(_from(mine, begin), end - begin)
        chosen = _shuffled(raw, self.buffer, rng) if self.shuffle else raw
        for about, packed in chosen:
            frame = read_frame(packed, self.layers)
            described = {name: about[name] for name in ("key", "exposure", "keyframe")}
            yield {**described, **to_tensors(frame)}

    def _order(self, epoch: int) -> list[data.Shard]:
        order = list(self.shards)
        if self.shuffle:
            random.Random(f"{self.seed} {epoch} shards").shuffle(order)
        return order

    def _least(self, order: list[data.Shard]) -> int:
        return min(sum(shard.samples for shard in order[rank :: self.world]) for rank in range(self.world))


def _from(shards: Iterable[data.Shard], skip: int) -> Iterator[Any]:
    """The samples of shards one after another, without the first ``skip``."""
    for shard in shards:
        if skip < shard.samples:
            yield from data._samples(shard.path, skip)
        skip = max(0, skip - shard.samples)


def _shuffled(samples: Iterator[Any], size: int, rng: random.Random) -> Iterator[Any]:
    """Draws from a buffer of ``size`` samples."""
    held: list[Any] = []
    for sample in samples:
        if len(held) < size:
            held.append(sample)
            continue
        place = rng.randrange(size)
        held[place], sample = sample, held[place]
        yield sample
    rng.shuffle(held)
    yield from held
