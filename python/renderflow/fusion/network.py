"""The network: dense 3 x 3 convolutions from 1/2 to 1/16 of the picture, without normalisation, and its weights files."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .. import _renderflow as _native
from . import head
from .batches import Batch, Groups

WIDTHS = (48, 64, 96, 128)
REFINES = (1, 1, 1, 1)

# Channels per pixel of each group: G-buffer, deferred, keys, samples, neighbours, denoised, paths.
_CHANNELS = (13, 18, 10, 11, 20, 3, 9)

# All groups, and those of frames without samples.
_ALL = Groups(True, True, True, True, True, True)
_PLAIN = Groups(True, True, False, False, False, False)


@dataclasses.dataclass(frozen=True)
class Outputs:
    """What the U-Net says about each pixel. :mod:`renderflow.fusion.head` names the channels."""

    fine: Tensor
    """(items, height/2, width/2, channels); the number of channels depends on the groups."""
    coarse: Tensor | None
    """(items, height/4, width/4, 25): the kernels of the coarsest scale; ``None`` without samples."""


class _Refine(nn.Module):
    """One or more times x + silu(conv(x))"""

    def __init__(self, width: int, count: int) -> None:
        super().__init__()
        self.conv = _conv(width, width)
        self.more = nn.ModuleList(_conv(width, width) for _ in range(1, count))

    def forward(self, x: Tensor) -> Tensor:
        for conv in (self.conv, *self.more):
            x = x + F.silu(conv(x))
        return x


def _conv(inputs: int, outputs: int, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, stride, padding=1)


class _UNet(nn.Module):
    """The layers for frames with some of the groups ``most``."""

    def __init__(self, w: tuple[int, ...], refines: tuple[int, ...], most: Groups) -> None:
        super().__init__()
        self.most = most
        levels = len(w)
        downwards = range(levels - 2, -1, -1)
        self.stem = _conv(4 * sum(count for count, given in zip(_CHANNELS, (True, *most)) if given), w[0])
        self.reduce = nn.ModuleList(_conv(w[level - 1], w[level], 2) for level in range(1, levels))
        self.down = nn.ModuleList(_Refine(width, count) for width, count in zip(w, refines))
        self.enter = nn.ModuleList(_conv(w[level + 1] + w[level], w[level]) for level in downwards)
        self.up = nn.ModuleList(_Refine(w[level], refines[level]) for level in downwards)
        self.fine = nn.Conv2d(w[0], head.outputs(most), 1)
        self.coarse = nn.Conv2d(w[1], head.KERNEL, 1) if most.samples else None

    def forward(self, batch: Batch) -> Outputs:
        groups = batch.groups
        x = batch.input.permute(0, 3, 1, 2)
        if groups.paths and not self.most.paths:
            # The inputs of paths come last.
            groups, x = groups._replace(paths=False), x[:, : -4 * _CHANNELS[-1]]
        x = F.silu(F.conv2d(x, self._stem_weight(groups), self.stem.bias, padding=1))
        skips = []
        for level, down in enumerate(self.down):
            if level > 0:
                skips.append(x)
                x = F.silu(self.reduce[level - 1](x))
            x = down(x)
        quarter = x
        for enter, up in zip(self.enter, self.up):
            quarter = x
            x = torch.cat([F.interpolate(x, scale_factor=2.0, mode="nearest"), skips.pop()], 1)
            x = up(F.silu(enter(x)))
        count = head.outputs(groups._replace(paths=False))
        weight, bias = self.fine.weight[:count], self.fine.bias[:count]
        if groups.paths:
            more = 4 * head.SCALES
            weight, bias = torch.cat([weight, self.fine.weight[-more:]]), torch.cat([bias, self.fine.bias[-more:]])
        fine = F.conv2d(x, weight, bias)
        if batch.groups.paths and not groups.paths:
            # With 0, the head treats indirect light as all other light.
            fine = F.pad(fine, (0, 0, 0, 0, 0, 4 * head.SCALES))
        coarse = self.coarse(quarter).permute(0, 2, 3, 1) if self.coarse is not None and groups.samples else None
        return Outputs(fine.permute(0, 2, 3, 1), coarse)

    def _stem_weight(self, groups: Groups) -> Tensor:
        """The weights of the inputs that are given. The other inputs would be zeros, and the last may have no weights."""
        parts, start = [], 0
        for channels, given in zip(_CHANNELS, (True, *groups)):
            if given:
                parts.append(self.stem.weight[:, 4 * start : 4 * (start + channels)])
            start += channels
        return torch.cat(parts, 1)


class Fusion(nn.Module):
    """The fusion network. ``widths`` are the channels of its four levels, multiples of 16 up to 1024, and ``refines`` are the
    residual convolutions of each level on either way, 1 to 8. Where it is ``separate``, frames without samples have a U-Net of
    their own, with the channels ``plain_widths`` (``widths`` if not given) and one residual convolution in each place. With
    ``paths``, it reads what samples are made of.

    A new network has the initial weights of the program's own training with this seed, and returns the best of its input
    pictures. Raises :class:`renderflow.Error` where a number is out of range.
    """

    def __init__(
        self,
        widths: Iterable[int] = WIDTHS,
        seed: int = 1,
        separate: bool = True,
        refines: Iterable[int] = REFINES,
        plain_widths: Iterable[int] | None = None,
        paths: bool = True,
    ) -> None:
        super().__init__()
        config = {"widths": list(widths), "refines": list(refines), "separate": separate, "paths": paths}
        if plain_widths is not None:
            config["plain_widths"] = list(plain_widths)
        self._fill(_native.Network.untrained(json.dumps(config), seed))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Fusion:
        """Reads a weights file of the program, in half or in single precision. The parameters are float32.

        Raises :class:`renderflow.Error` where the file cannot be read or is not of this network.
        """
        return cls._of(_native.Network.load(os.fspath(path)))

    @classmethod
    def shipped(cls) -> Fusion:
        """The weights inside the program. Raises :class:`renderflow.Error` where this build has none."""
        return cls._of(_native.Network.load(None))

    @classmethod
    def _of(cls, native: _native.Network) -> Fusion:
        made = cls.__new__(cls)
        nn.Module.__init__(made)
        made._fill(native)
        return made

    def _fill(self, native: _native.Network) -> None:
        """Makes the layers, and takes their values from the program's network."""
        self._config: str = native.config
        config = json.loads(native.config)
        self.widths: tuple[int, ...] = tuple(config["widths"])
        self.refines: tuple[int, ...] = tuple(config["refines"])
        self.steps: int = native.steps
        """Number of training steps, which a weights file records. Whoever trains the network counts them here."""
        self.seed: int = native.seed
        self.separate: bool = config["separate"]
        self.paths: bool = config["paths"]
        self.plain_widths: tuple[int, ...] | None = tuple(config.get("plain_widths") or self.widths) if self.separate else None
        self.sampled = _UNet(self.widths, self.refines, _ALL._replace(paths=self.paths))
        self.plain = _UNet(self.plain_widths, REFINES, _PLAIN) if self.plain_widths else None
        # The program stores kernels as (rows, columns, inputs, outputs).
        values = {name: torch.from_numpy(array) for name, array in native.parameters().items()}
        self.load_state_dict({name: v.permute(3, 2, 0, 1) if v.ndim == 4 else v for name, v in values.items()})

    def _native(self) -> _native.Network:
        """The program's network with these weights."""
        arrays = {}
        for name, value in self.state_dict().items():
            value = value.detach().float().cpu()
            arrays[name] = (value.permute(2, 3, 1, 0) if value.ndim == 4 else value).contiguous().numpy()
        return _native.Network.of(self._config, self.steps, self.seed, arrays)

    def save(self, path: str | os.PathLike[str], half: bool = True) -> None:
        """Writes a weights file that the program reads, in half precision or, without ``half``, in single precision.

        Equal weights give equal bytes. The file is written beside its place and renamed. Raises :class:`renderflow.Error` where
        it cannot be written or a value is not finite.
        """
        self._native().save(os.fspath(path), half)

    def outputs(self, batch: Batch) -> Outputs:
        """Runs the U-Net of the batch's groups."""
        return (self.sampled if self.plain is None or batch.groups.samples else self.plain)(batch)

    def forward(self, batch: Batch) -> Tensor:
        """The pictures (items, height, width, 3) of a batch: exposed linear radiance, 0..65504."""
        outputs = self.outputs(batch)
        # The head divides by small coverages, for which half precision is too coarse.
        exact = torch.promote_types(outputs.fine.dtype, batch.tint.dtype)
        with torch.autocast(batch.input.device.type, enabled=False):
            coarse = None if outputs.coarse is None else outputs.coarse.to(exact)
            return head.draw(batch, outputs.fine.to(exact), coarse)
