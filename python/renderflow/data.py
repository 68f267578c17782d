"""Datasets on disk, with numpy alone: folders that ``renderflow dataset render`` wrote, and shards that ``dataset pack`` wrote."""

from __future__ import annotations

import itertools
import json
import os
import re
import tarfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import Frame, read_frame

__all__ = ["Dataset", "Shard", "read_shard", "shards"]

_FRAME = re.compile(r"frame\.(\d+)\.(exr|rff)")


def _place(path: Path) -> tuple[Path, int, str]:
    """Orders frames by their numbers, which have more than four digits from 10000 on."""
    match = _FRAME.fullmatch(path.name)
    return path.parent, int(match[1]) if match else 0, path.name


def _is_aside(path: Path, root: Path) -> bool:
    """Whether a dataset in ``root`` or below it has put a file aside: into its folder ``aside``, which lies beside its plan."""
    above = (root / part for part in path.relative_to(root).parents if part.name == "aside")
    return any(folder.with_name("plan.json").exists() for folder in above)


class Dataset(Sequence[Frame]):
    """The frames of a dataset, in order of their sequences. ``folder`` is a dataset, one split of it, or one sequence.

    ``dataset[i]`` reads a frame. ``paths[i]`` is its file. ``layers`` selects layers; ``None`` reads all. What a repair has put aside
    does not count.
    """

    def __init__(self, folder: str | os.PathLike[str], split: str | None = None, layers: Iterable[str] | None = None) -> None:
        root = Path(folder)
        root = root / split if split is not None else root
        if not root.is_dir():
            raise FileNotFoundError(f"{root}: there is no such folder")
        self.layers = None if layers is None else tuple(layers)
        found = (path for path in root.rglob("frame.*") if _FRAME.fullmatch(path.name))
        self.paths = sorted((path for path in found if not _is_aside(path, root)), key=_place)
        if not self.paths:
            raise ValueError(f"{root}: holds no frames")

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Frame:  # type: ignore[override]
        return read_frame(self.paths[index], self.layers)

    def sequences(self) -> dict[Path, list[int]]:
        """The indices of the frames of each sequence folder."""
        found: dict[Path, list[int]] = {}
        for index, path in enumerate(self.paths):
            found.setdefault(path.parent, []).append(index)
        return found


@dataclass(frozen=True)
class Shard:
    """A tar file of frames."""

    path: Path
    samples: int
    """Number of frames."""


def shards(folder: str | os.PathLike[str], split: str = "train") -> list[Shard]:
    """The shards of a split that hold frames. Raises ``ValueError`` where the folder has no such split."""
    root = Path(folder)
    manifest = json.loads((root / "manifest.json").read_text(encoding="utf-8"))
    if "shards" not in manifest:
        raise ValueError(f"{root}: is no folder of shards; renderflow dataset pack makes one")
    of_frames = [shard for shard in manifest["shards"] if shard["kind"] == "frames"]
    found = [Shard(root / shard["file"], shard["samples"]) for shard in of_frames if shard["split"] == split]
    if not found:
        known = sorted({shard["split"] for shard in of_frames})
        raise ValueError(f"{root}: no split {split!r}, but {', '.join(known) or 'none at all'}")
    return found


def read_shard(path: str | os.PathLike[str], layers: Iterable[str] | None = None) -> Iterator[tuple[dict[str, Any], Frame]]:
    """The description and the frame of every sample in a shard, in order."""
    for about, data in _samples(path):
        yield about, read_frame(data, layers)


def _samples(path: str | os.PathLike[str], skip: int = 0) -> Iterator[tuple[dict[str, Any], bytes]]:
    """The description and the bytes of every frame but the first ``skip``: in the file, a frame comes before its description."""
    data = b""
    with tarfile.open(path, "r:") as archive:  # Without the colon, it would try to decompress first.
        for member in itertools.islice(archive, 2 * skip, None):
            file = archive.extractfile(member)
            if file is None:
                continue
            if member.name.endswith(".json"):
                yield json.loads(file.read()), data
            else:
                data = file.read()
