"""RenderFlow: path-traced ground truth, G-buffers and a single-step neural renderer, as numpy arrays.

    import renderflow as rf

    scene = rf.compose(seed=7)
    frame = rf.render(scene, spp=64)
    frame["beauty"]      # float32 (height, width, 3), scene-linear Rec.709
    frame.display()      # uint8, ready for PIL or matplotlib

Pictures are float32 arrays of shape (height, width, 3), scene-linear unless a function says otherwise. Row 0 is at the top. The
world has +Y up and metres; camera space has +x right, +y up and +z to the viewer. Renders, denoisers and metrics release the
interpreter's lock. Renders use every core and stop at Ctrl-C. Reading weights and describing a scene keep the lock.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _oidn
from ._renderflow import Error, Neural as _Neural, Scene as _Scene, __version__
from . import _renderflow as _native
from ._frame import Frame, to_display

__all__ = [
    "Error",
    "Frame",
    "Lpips",
    "Neural",
    "Scene",
    "__version__",
    "compose",
    "deferred",
    "denoise",
    "denoiser",
    "flip",
    "gbuffer",
    "load",
    "lpips",
    "psnr",
    "read_frame",
    "render",
    "ssim",
    "to_display",
]

_oidn.find()

Picture = NDArray[np.float32]
Denoise = Literal["auto", "oidn", "neural", "none"]
Quality = Literal["fast", "high"]
PathLike = str | os.PathLike[str]


class Scene:
    """A scene, from :func:`compose`, :func:`load` or :meth:`from_dict`. It cannot change: change :meth:`to_dict` instead.

    It is loaded when the first picture of it is made, and then kept, so the second picture is cheaper.
    """

    def __init__(self, native: _Scene) -> None:
        self._native = native

    @classmethod
    def from_dict(
        cls, description: Mapping[str, Any], folder: PathLike = ".", allow_files: PathLike | Iterable[PathLike] = ()
    ) -> Scene:
        """The scene that a description says. Its form is that of scene files (``renderflow schema``); numbers and arrays of numpy
        may stand in it.

        Relative paths in it start from ``folder``. It may name files there and in ``allow_files``, a folder or several.
        """
        return cls(_native.describe(_json(description), os.fspath(folder), _folders(allow_files)))

    def to_dict(self) -> dict[str, Any]:
        """The description of the scene, with every default written out."""
        return json.loads(self._native.to_json())

    def save(self, path: PathLike) -> None:
        """Writes the scene file that the command line takes.

        Names of files stay as they are where they start from the folder of ``path``, and become full paths elsewhere. Whoever
        reads the file then allows the folders of what lies outside of its own (``allow_files``, or ``--allow-files``).
        """
        path = Path(path)
        description = json.loads(self._native.json_in(os.fspath(path.parent)))
        path.write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self._native.frames

    @property
    def resolution(self) -> tuple[int, int]:
        """Columns and rows."""
        return self._native.resolution

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self._native.seed

    @property
    def hash(self) -> str:
        """BLAKE3 of the description, 64 hexadecimal digits. Equal scenes have equal hashes."""
        return self._native.hash

    @property
    def notes(self) -> list[str]:
        """What was decided about the scene that a person should know, one sentence each."""
        return self._native.notes

    def __repr__(self) -> str:
        return repr(self._native)


def _json(value: Any) -> str:
    """The JSON of a value in which numbers and arrays of numpy may stand."""
    return json.dumps(value, allow_nan=False, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{value!r} has no form in JSON")


def _folders(allowed: PathLike | Iterable[PathLike]) -> list[str]:
    """The folders that are allowed."""
    # The letters of a path are no folders: the first may be "/", which would allow every file.
    alone = isinstance(allowed, (str, os.PathLike))
    return [os.fspath(folder) for folder in ([allowed] if alone else allowed)]


def _size(resolution: int | tuple[int, int]) -> tuple[int, int]:
    if isinstance(resolution, (int, np.integer)):
        return int(resolution), int(resolution)
    width, height = resolution
    return int(width), int(height)


def compose(seed: int = 1, *, resolution: int | tuple[int, int] = 256, frames: int = 1) -> Scene:
    """Composes a scene from a seed: shapes, materials, light and a camera that moves. Equal seeds give equal scenes.

    ``resolution`` is one number for both sides, or (columns, rows). The meshes and the light come from families that training
    never sees.
    """
    return Scene(_native.compose(seed, _size(resolution), frames))


def load(
    path: PathLike,
    *,
    hdri: str | None = None,
    hdri_rotation: float | None = None,
    resolution: int | tuple[int, int] | None = None,
    frames: int | None = None,
    seed: int | None = None,
    camera: str | int | None = None,
    cameras: PathLike | None = None,
    animation: str | int | None = None,
    set: Mapping[str, Any] | None = None,
    allow_files: PathLike | Iterable[PathLike] = (),
) -> Scene:
    """Reads a scene file (.json), or puts a model (.gltf, .glb, .obj, .ply) on a ground plane under a light.

    ``hdri`` is an environment map (.hdr, .exr) or the name of a built-in one; ``hdri_rotation`` turns it, in degrees about +Y.
    ``camera`` looks through a camera of a glTF file, and ``animation`` plays one of its animations: a name, or a number counted from
    0. ``cameras`` is a ``transforms.json`` with one camera for each frame.

    ``set`` changes values of the scene by their paths, as in ``{"materials/0/roughness": 0.2}``. The file may name files in its
    own folder and in ``allow_files``, a folder or several. Raises :class:`Error` where a file cannot be read or holds something
    that cannot be rendered.
    """
    asked = {
        "file": os.fspath(path),
        "hdri": hdri,
        "hdri_rotation": hdri_rotation,
        "seed": seed,
        "resolution": None if resolution is None else _size(resolution),
        "frames": frames,
        "camera": None if camera is None else str(camera),
        "cameras": None if cameras is None else os.fspath(cameras),
        "animation": None if animation is None else str(animation),
        "set": [f"{path}={_json(value)}" for path, value in (set or {}).items()],
        "allowed": _folders(allow_files),
    }
    return Scene(_native.load(asked))


def render(
    scene: Scene,
    frame: int = 0,
    *,
    spp: int = 256,
    max_bounces: int = 6,
    denoise: Denoise = "auto",
    distance: bool = False,
    **settings: Any,
) -> Frame:
    """Path-traces a frame, with every channel of the G-buffer.

    ``spp`` is the number of samples per pixel, 1 to 2**24. ``denoise`` is "auto" (OIDN where it is found), "oidn", "neural" (the
    network inside the program, for up to 32 samples), or "none". ``distance`` adds the Euclidean distance to the planar depth.
    Other keyword arguments are settings of the renderer, such as ``light_groups``, ``irradiance`` and ``branches``;
    ``channels={"paths": True}`` adds the layers ``indirect`` and ``hidden``;
    ``budget="average"`` is what plans call ``adaptive``, and ``budget="detail"`` spreads few samples for a denoiser. Raises
    :class:`Error` where the frame takes more memory than there is.

    Returns a :class:`Frame`: a dict of arrays. The same arguments give the same bytes on every machine with the same kind of
    processor, for any number of threads.
    """
    options = _json({"spp": spp, "max_bounces": max_bounces, **settings})
    return Frame._of(_native.render(scene._native, frame, options, denoise, distance))


def gbuffer(scene: Scene, frame: int = 0, *, rays: int = 16) -> Frame:
    """The G-buffer of a frame without a picture. ``rays`` per pixel are traced for coverage and guides; all else is one ray
    through the centre of each pixel."""
    return Frame._of(_native.gbuffer(scene._native, frame, _json({"guide_samples": rays, "spp": 1})))


def deferred(scene: Scene, frame: int = 0) -> Picture:
    """A frame as a good game engine shades it: shadow maps, split sum, ambient occlusion, screen-space reflections, one bounce.
    No path is traced. Returns scene-linear radiance (height, width, 3)."""
    return _native.deferred(scene._native, frame)


class Neural:
    """The neural renderer. ``weights`` is a file that ``renderflow train`` wrote; without it, the weights inside the program are
    used. ``device`` is where the network runs, as in ``renderflow --device``; GPUs need a wheel that was built with the feature
    ``vulkan`` or ``cuda``. Raises :class:`Error` where the file is no network of this kind, or the device cannot be used."""

    def __init__(self, weights: PathLike | None = None, device: str = "cpu") -> None:
        self._native = _Neural(None if weights is None else os.fspath(weights), device)

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return self._native.parameters

    def render(self, scene: Scene, frame: int = 0, *, rays: int = 0, oidn: Quality | None | Literal["auto"] = "auto") -> Picture:
        """The picture of a frame: from the G-buffer and deferred shading, or with ``rays`` traced samples per pixel (up to 32 are
        useful).

        With samples, the network also reads OIDN's picture of them: of quality ``oidn``, of none, or of the best one where OIDN is
        found ("auto"). Returns scene-linear radiance (height, width, 3).
        """
        if oidn == "auto":
            oidn = "high" if denoiser() is not None else None
        return self._native._render(scene._native, frame, rays, oidn)


def _picture(picture: ArrayLike) -> Picture:
    return np.ascontiguousarray(picture, dtype=np.float32)


def _maybe(picture: ArrayLike | None) -> Picture | None:
    return None if picture is None else _picture(picture)


def _display(picture: ArrayLike) -> Picture:
    picture = np.asarray(picture)
    # Bytes would be clipped to 0..1 and all look the same.
    if picture.dtype.kind in "iu":
        raise ValueError(f"display values in 0..1 are needed, not {picture.dtype}: divide bytes by 255")
    return _picture(picture)


def denoise(
    color: ArrayLike,
    albedo: ArrayLike | None = None,
    normal: ArrayLike | None = None,
    *,
    quality: Quality = "high",
    clean_guides: bool = True,
) -> Picture:
    """Denoises scene-linear radiance (height, width, 3) with Intel Open Image Denoise.

    ``albedo`` (0..1) and ``normal`` (-1..1, zero at a miss) guide it, such as ``frame["guide_albedo"]`` and
    ``frame["guide_normal"]``. ``clean_guides`` says that they have no noise. Raises :class:`Error` where OIDN is not found.
    """
    return _native.denoise(_picture(color), _maybe(albedo), _maybe(normal), quality, clean_guides)


def denoiser() -> Path | None:
    """Where Intel Open Image Denoise was found; ``None`` where it was not. ``pip install pyoidn`` brings it."""
    return _native.denoiser()


def psnr(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """PSNR in dB of display values in 0..1, over all pixels or over those where ``mask`` (height, width) is above 0. Equal
    pictures give infinity."""
    return _native.psnr(_display(image), _display(reference), _maybe(mask))


def ssim(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """SSIM of display values in 0..1, as scikit-image computes it with ``gaussian_weights=True, sigma=1.5,
    use_sample_covariance=False, data_range=1, channel_axis=2``."""
    return _native.ssim(_display(image), _display(reference), _maybe(mask))


def flip(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Mean LDR-FLIP of display values in 0..1, at 67 pixels per degree. 0 means no visible difference."""
    return _native.flip(_display(image), _display(reference), _maybe(mask))


class Lpips:
    """LPIPS of display values in 0..1. ``folder`` has ``lpips_alex.safetensors`` or ``lpips_squeeze.safetensors``, which are not
    part of this package; without it, the environment variable ``RENDERFLOW_LPIPS_WEIGHTS`` names the folder."""

    def __init__(self, folder: PathLike | None = None, net: Literal["alex", "squeeze"] = "alex") -> None:
        folder = folder if folder is not None else os.environ.get("RENDERFLOW_LPIPS_WEIGHTS")
        if folder is None:
            raise Error("LPIPS needs its weights: pass their folder, or set RENDERFLOW_LPIPS_WEIGHTS")
        self._native = _native.Lpips(os.fspath(folder), net)

    def __call__(self, image: ArrayLike, reference: ArrayLike) -> float:
        """The distance of two pictures (height, width, 3)."""
        return self._native(_display(image), _display(reference))


def lpips(image: ArrayLike, reference: ArrayLike) -> float:
    """LPIPS (AlexNet) of display values in 0..1. This reads the weights each time: make an :class:`Lpips` for many pictures."""
    return Lpips()(image, reference)


def read_frame(source: PathLike | bytes, layers: Iterable[str] | None = None) -> Frame:
    """Reads a frame file, OpenEXR or compact (.rff), from a path or from its bytes. ``layers`` selects layers; ``None`` reads all.

    Raises :class:`Error` where the bytes are no frame, ``KeyError`` where a layer is missing, and ``OSError`` where the file
    cannot be read.
    """
    if isinstance(source, (bytes, bytearray, memoryview)):
        name, data = "frame", bytes(source)
    else:
        name, data = os.fspath(source), Path(source).read_bytes()
    return Frame._of(_native.decode_frame(name, data, None if layers is None else [layers] if isinstance(layers, str) else list(layers)))
