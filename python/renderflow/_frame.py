"""Frames: a dict of arrays, and the values of the header."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Frame(dict[str, np.ndarray]):
    """The layers of one frame by name, as arrays (height, width) or (height, width, components).

    ``beauty``, ``raw``, ``variance``, ``indirect``, ``hidden`` and ``light.N`` hold scene-linear radiance; ``alpha`` is coverage.
    ``albedo``, ``normal`` (camera space), ``depth`` (planar, metres, +inf at a miss), ``material`` (roughness, metallic,
    specular), ``object_id`` and ``material_id`` (uint32, 0 = none) are one sample at the centre of the pixel. ``motion`` and
    ``motion_prev`` are in pixels, to the next and to the previous frame. ``guide_albedo`` and ``guide_normal`` are filtered over
    the pixel. A layer that a frame lacks is absent.
    """

    info: dict[str, Any]
    """The header: camera, samples per pixel, seed, hash of the scene, exposure, denoiser.

    ``info["camera"]["camera_to_world"]`` has 12 numbers, the four columns of a 3 x 4 matrix one after the other:
    ``numpy.reshape(numbers, (4, 3)).T``. The matrices of ``transforms.json`` are lists of rows.
    """

    def __init__(self, *args: Any, info: dict[str, Any] | None = None, **layers: np.ndarray) -> None:
        super().__init__(*args, **layers)
        self.info = info or {}

    @classmethod
    def _of(cls, made: tuple[dict[str, np.ndarray], str]) -> Frame:
        layers, info = made
        return cls(layers, info=json.loads(info))

    @property
    def exposure(self) -> float:
        """Factor from scene-linear radiance to display-linear values."""
        return float(self.info.get("exposure", 1.0))

    def display(self, layer: str = "beauty") -> NDArray[np.uint8]:
        """A radiance layer as a picture to look at: exposed, with the sRGB curve, 8 bits."""
        return to_display(self[layer], self.exposure)


def to_display(radiance: np.ndarray, exposure: float = 1.0) -> NDArray[np.uint8]:
    """Scene-linear radiance as sRGB bytes."""
    return (255 * srgb(np.asarray(radiance, np.float32) * np.float32(exposure)) + 0.5).astype(np.uint8)


def srgb(linear: np.ndarray) -> np.ndarray:
    """The sRGB curve over linear values, which are clipped to 0..1."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
