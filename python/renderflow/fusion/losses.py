"""The loss of rendered pictures: the error that PSNR measures, and two terms for dark and bright parts and for edges."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import torch
from torch import Tensor

from .batches import Batch

# Added to the mean squared error before its logarithm: the error at 50 dB.
_LEAST = 1e-5


class LossWeights(NamedTuple):
    """Weights of the terms of the loss."""

    psnr: float = 0.01
    """Natural logarithm of the mean squared error of each display picture against the raw truth."""
    display: float = 0.0
    """Squared error of the display picture against the raw truth."""
    log: float = 0.1
    """Absolute error in the logarithmic curve."""
    gradient: float = 0.05
    """Absolute error of the display picture's differences between neighbours."""


@dataclasses.dataclass(frozen=True)
class Loss:
    """The loss of each picture and its terms, (items,). Terms are means over the three channels of what shows a surface."""

    total: Tensor
    """What is minimised: the mean over the items of a batch."""
    display: Tensor
    """Mean squared error of display values against the raw truth; PSNR is -10 log10 of it."""
    log: Tensor
    """Mean absolute error in the logarithmic curve."""
    gradient: Tensor
    """Mean absolute error of differences between neighbouring pixels."""


def display(linear: Tensor) -> Tensor:
    """The display value 0..1 of exposed linear radiance, of any shape. Clamped values have no derivative."""
    inside = (linear > 0) & (linear < 1)
    x = torch.where(inside, linear, linear.detach().clamp(0, 1))
    # The power has no finite derivative at 0, and must not be asked for it.
    curve = 1.055 * x.clamp(min=1e-3) ** (1 / 2.4) - 0.055
    return torch.where(x <= 0.0031308, 12.92 * x, curve)


def loss(picture: Tensor, batch: Batch, weights: LossWeights = LossWeights()) -> Loss:
    """The loss of pictures (items, height, width, 3) that were rendered from ``batch``."""
    covered = batch.alpha > 0
    # Squares lead to the mean of noisy pictures. Noise in the raw truth averages out, but for a little darkening by the display curve.
    squares = _mean((display(picture) - display(batch.raw)).square(), covered)
    error = display(picture) - display(batch.truth)
    log = _mean((torch.log1p(8 * picture) - torch.log1p(8 * batch.truth)).abs() / math.log(9), covered)
    right = (error[:, :, :-1] - error[:, :, 1:]).abs()
    below = (error[:, :-1] - error[:, 1:]).abs()
    gradient = _mean(right, covered[:, :, :-1] & covered[:, :, 1:]) + _mean(below, covered[:, :-1] & covered[:, 1:])
    total = weights.psnr * torch.log1p(squares / _LEAST) + weights.display * squares
    return Loss(total + weights.log * log + weights.gradient * gradient, squares, log, gradient)


def psnr(picture: Tensor, truth: Tensor, alpha: Tensor) -> Tensor:
    """PSNR in dB, (items,), of the display pictures (items, height, width, 3) where ``alpha`` (items, height, width) is above
    0."""
    squares = _mean((display(picture) - display(truth)).double().square(), alpha > 0)
    return -10 * torch.log10(squares.clamp(min=1e-10))


def _mean(values: Tensor, where: Tensor) -> Tensor:
    """The mean of values (items, height, width, 3) over some of the pixels, (items,); 0 if there is none."""
    count = 3 * where.sum((1, 2)).clamp(min=1)
    return torch.where(where.unsqueeze(-1), values, 0.0).sum((1, 2, 3)) / count
