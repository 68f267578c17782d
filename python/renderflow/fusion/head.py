"""The head: it computes the picture from the outputs of the U-Net. It has no parameters.

The samples of the frame and its neighbours, divided by the reflectance, are blended with predicted weights, and filtered with
predicted kernels of 5 x 5 pixels on scales of 1, 2 and 4 pixels. Where it is known which part of them is indirect light, that
part has the same kernels and its own weights of the scales. The candidates are the filtered samples, the specular reflection of
the environment, the picture of another denoiser, the warped keyframes, and the sum of the scaled terms of deferred shading. They
are mixed with softmax weights. A share of the specular reflection and a residual are added, and the environment is put behind the
surface.

The outputs at half size stand in this order: for each of the four pixels of a block ``BASE`` numbers; with samples, for each of
them ``TRACED`` numbers, then the kernel of scale 2; with neighbours, for each of them ``MERGE`` numbers; with paths, for each of
them ``SCALES`` numbers. Constants and formulas are those of ``model/src/fusion/head.rs``, which has its derivatives by hand; here
they come from automatic differentiation.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from .batches import Batch, Groups

KEYS = 2
TERMS = 4
NEIGHBOURS = 4
SIDE = 5
KERNEL = SIDE * SIDE
SCALES = 3
# Logits of filtered samples, keyframes and deferred shading.
CANDIDATES = 2 + KEYS

BASE = CANDIDATES + TERMS + 3
TRACED = KERNEL + SCALES + 3
MERGE = 1 + NEIGHBOURS

# Largest absolute logarithm of a factor.
MOST = 4.0
# Logits before training of samples, keyframes, the denoised picture, the centre of a kernel, and the finest scale.
TRUST_SAMPLES, TRUST_KEYS, TRUST_DENOISED, MIDDLE, FINEST = 5.0, 3.0, 8.0, 2.0, 1.0
# Coverage up to here counts as none.
NOTHING = 1e-6
MAX_RADIANCE = 65504.0
# The logit of a candidate that is absent. Unlike minus infinity, it gives no NaN where all are absent.
ABSENT = -1e30


def outputs(groups: Groups) -> int:
    """Number of outputs at half size for these groups."""
    traced = 4 * TRACED + KERNEL if groups.samples else 0
    return 4 * (BASE + MERGE * groups.neighbours + SCALES * groups.paths) + traced


def draw(batch: Batch, fine: Tensor, coarse: Tensor | None) -> Tensor:
    """The pictures (items, height, width, 3) from the outputs ``fine`` (items, height/2, width/2, channels) and ``coarse``
    (items, height/4, width/4, 25): exposed linear radiance, 0..65504."""
    groups = batch.groups
    base = _pixels(fine[..., : 4 * BASE])
    logits, factors, residual = base.split([CANDIDATES, TERMS, 3], -1)
    # Logits (items, height, width) and pictures (items, height, width, 3) of the candidates.
    candidates: list[tuple[Tensor, Tensor]] = []
    added = batch.tint * residual
    if groups.samples:
        traced = _pixels(fine[..., 4 * BASE : 4 * (BASE + TRACED)])
        kernel, scales, extra = traced.split([KERNEL, SCALES, 3], -1)
        middle = 4 * (BASE + TRACED) + KERNEL
        merge = _pixels(fine[..., middle : middle + 4 * MERGE]) if groups.neighbours else None
        kernels = [kernel, fine[..., middle - KERNEL : middle], coarse]
        split = _pixels(fine[..., -4 * SCALES :]) if groups.paths else None
        filtered, there = _filtered(_merged(batch, merge), kernels, scales, split)
        candidates.append((torch.where(there, logits[..., 0] + TRUST_SAMPLES, ABSENT), filtered * batch.tint))
        candidates.append((extra[..., 0], batch.reflected))
        added = added + extra[..., 1:2] * batch.reflected
        if groups.denoised:
            candidates.append((extra[..., 2] + TRUST_DENOISED, batch.denoised))
    if groups.keys:
        for k in range(KEYS):
            trust = batch.trust[..., k].clamp(min=ABSENT)
            candidates.append((logits[..., 1 + k] + TRUST_KEYS + trust, batch.keys[..., k, :]))
    if groups.deferred:
        shaded = (batch.terms * factors.clamp(-MOST, MOST).exp().unsqueeze(-1)).sum(-2)
        candidates.append((logits[..., 1 + KEYS], shaded))
    if candidates:
        weights = torch.softmax(torch.stack([logit for logit, _ in candidates], -1), -1)
        added = added + (weights.unsqueeze(-1) * torch.stack([picture for _, picture in candidates], -2)).sum(-2)
    alpha = batch.alpha.unsqueeze(-1)
    value = alpha * added + (1 - alpha) * batch.background
    value = torch.where(alpha > 0, value, batch.background)
    # Clamped values have no derivative.
    inside = (value > 0) & (value < MAX_RADIANCE)
    return torch.where(inside, value, value.detach().nan_to_num(0.0).clamp(0, MAX_RADIANCE))


def _pixels(blocks: Tensor) -> Tensor:
    """From (items, height/2, width/2, 4 channels), the four pixels of a block row by row, to (items, height, width, channels)."""
    items, rows, columns, count = blocks.shape
    blocks = blocks.reshape(items, rows, columns, 2, 2, count // 4)
    return blocks.permute(0, 1, 3, 2, 4, 5).reshape(items, 2 * rows, 2 * columns, count // 4)


def _merged(batch: Batch, merge: Tensor | None) -> Tensor:
    """The samples of the frame and of its neighbours (items, height, width, 7): radiance divided by the reflectance, times
    coverage; coverage; the part of the radiance that is indirect light, 0 where it is not known."""
    own = _lanes(batch.own, None if batch.paths is None else batch.paths[..., :3])
    if merge is None:
        return own
    weights = torch.softmax(merge, -1)
    others = _lanes(batch.others, batch.others_indirect)
    return weights[..., :1] * own + (weights[..., 1:].unsqueeze(-1) * others).sum(-2)


def _lanes(samples: Tensor, indirect: Tensor | None) -> Tensor:
    """Samples (.., 4), and the part of them that is indirect light; 0 where it is not known."""
    if indirect is None:
        return F.pad(samples, (0, 3))
    return torch.cat([samples, torch.minimum(indirect, samples[..., :3])], -1)


def _filtered(samples: Tensor, kernels: list[Tensor], scales: Tensor, split: Tensor | None) -> tuple[Tensor, Tensor]:
    """The filtered samples (items, height, width, 3) of all scales, and where there are any (items, height, width)."""
    first, *others = scales.unbind(-1)
    logits = torch.stack([first + FINEST, *others], -1)
    shares = torch.softmax(logits, -1)
    apart = shares if split is None else torch.softmax(logits + split, -1)
    size = samples.shape[1:3]
    level = samples.permute(0, 3, 1, 2)
    total, alike, indirect = (torch.zeros_like(level[:, :4]) for _ in range(3))
    for scale, kernel in enumerate(kernels):
        if scale > 0:
            level = F.avg_pool2d(level, 2)
        # A pixel without samples has no influence.
        filtered = _quotient(_convolved(level, kernel))
        if scale > 0:
            filtered = F.interpolate(filtered, size=size, mode="bilinear", align_corners=False)
        # All light less the indirect part, and that part, each with what it is divided by.
        direct = torch.cat([filtered[:, :3] - filtered[:, 4:], filtered[:, 3:4]], 1)
        share, rest = shares[..., scale].unsqueeze(1), torch.cat([filtered[:, 4:], filtered[:, 3:4]], 1)
        total, alike = total + share * direct, alike + share * rest
        indirect = indirect + apart[..., scale].unsqueeze(1) * rest
    total, alike, indirect = _quotient(total), _quotient(alike), _quotient(indirect)
    # Where indirect light weighs nothing at the scales that have samples, it has the weights of all light.
    indirect = torch.where(indirect[:, 3:] > 0, indirect, alike)
    return (total[:, :3] + indirect[:, :3]).permute(0, 2, 3, 1), total[:, 3] > 0


def _convolved(level: Tensor, kernel: Tensor) -> Tensor:
    """The weighted sums (items, 7, height, width) of the 5 x 5 pixels around each pixel. The largest weight is 1."""
    items, channels, height, width = level.shape
    logits = kernel.permute(0, 3, 1, 2)
    logits = torch.cat([logits[:, : KERNEL // 2], logits[:, KERNEL // 2, None] + MIDDLE, logits[:, KERNEL // 2 + 1 :]], 1)
    weights = (logits - logits.detach().amax(1, keepdim=True)).exp()
    around = F.unfold(level, SIDE, padding=SIDE // 2).view(items, channels, KERNEL, height, width)
    return (around * weights.unsqueeze(1)).sum(2)


def _quotient(sums: Tensor) -> Tensor:
    """Divides all channels by the fourth, and sets the fourth to 1; all are 0 where the fourth is almost 0."""
    there = sums[:, 3:4] > NOTHING
    quotient = torch.where(there, sums / torch.where(there, sums[:, 3:4], 1.0), 0.0)
    return torch.cat([quotient[:, :3], there.to(sums.dtype), quotient[:, 4:]], 1)
