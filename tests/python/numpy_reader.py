"""Reads RenderFlow's frames and shards with numpy, zstandard and OpenEXR alone, so that tests compare our reader with another one.

Layers are float32 (height, width[, components]): scene-linear Rec.709; camera space with +x right, +y up, +z to the viewer; depth in
metres, +inf at a miss. Ids are uint32. Layout and precision of .rff: renderer/frame/src/compact.rs."""
import json
import struct
import tarfile
import tempfile

import numpy as np

ITEM = {"half": 2, "float": 4, "unit8": 1, "srgb8": 1, "octahedral12": 2, "depth16": 2, "u8": 1, "u16": 2, "u32": 4}


def read_rff(data, layers=None):
    """Header and layers (all, or those named) of a compact frame in `data` (bytes)."""
    import zstandard

    unzip = zstandard.ZstdDecompressor().decompress
    signature, stored, _ = struct.unpack("<8s2I", data[:16])
    if signature != b"\x93RFF\1\0\0\0":
        raise ValueError("not a compact frame of version 1")
    header, start = json.loads(unzip(data[16 : 16 + stored])), 16 + stored
    found = {}
    for layer in (layer for layer in header["layers"] if layers is None or layer["name"] in layers):
        size, begin = ITEM[layer["encoding"]], start + layer["offset"]
        planes = np.frombuffer(unzip(data[begin : begin + layer["bytes"]]), "u1").reshape(-1, size, header["height"], header["width"])
        numbers = np.ascontiguousarray(np.moveaxis(planes, 1, -1)).view(f"<u{size}")[..., 0]
        if layer["delta"]:
            numbers = np.cumsum(numbers, axis=1, dtype=numbers.dtype)
        found[layer["name"]] = decode(numbers, layer)
    return header, found


def decode(numbers, layer):
    """Values of the numbers (components, height, width) of a layer."""
    encoding = layer["encoding"]
    if encoding == "octahedral12":
        x, y = (numbers.astype("f4") - 2048) / np.float32(2047)
        z = 1 - abs(x) - abs(y)
        fold = np.maximum(-z, 0)
        values = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], -1)
        values /= np.linalg.norm(values, axis=-1, keepdims=True)
        return values * numbers.any(0)[..., None]
    if encoding == "depth16":
        bits = np.uint32(layer["lowest"]) + (numbers[0].astype("u4") - np.uint32(1)) * np.uint32(layer["step"])
        return np.where(numbers[0] == 0, np.float32(np.inf), bits.view("f4"))
    if encoding == "half":
        numbers = numbers.view("<f2").astype("f4")
    elif encoding == "float":
        numbers = numbers.view("<f4")
    elif encoding == "unit8":
        numbers = numbers.astype("f4") / np.float32(255)
    elif encoding == "srgb8":
        n = numbers / 255
        numbers = np.where(n <= 0.04045, n / 12.92, ((n + 0.055) / 1.055) ** 2.4).astype("f4")
    else:
        numbers = numbers.astype("u4")
    return np.moveaxis(numbers, 0, -1) if len(layer["components"]) > 1 else numbers[0]


def read_exr(data, layers=None):
    """Header and layers of an OpenEXR frame in `data` (bytes), named as in compact frames."""
    import OpenEXR

    with tempfile.NamedTemporaryFile(suffix=".exr") as copy:  # OpenEXR reads from files only
        copy.write(data)
        copy.flush()
        with OpenEXR.File(copy.name, separate_channels=True) as file:
            header, channels, groups = file.header(), {name: c.pixels for name, c in file.channels().items()}, {}
    for name in channels:
        layer, _, component = name.rpartition(".")
        groups.setdefault(layer or ("alpha" if component == "A" else "beauty"), []).append(name)
    found = {}
    for layer, names in groups.items():
        names.sort(key=lambda name: "RGBXYZ".find(name[-1]))
        if layers is None or layer in layers:
            pictures = np.stack([channels[name] for name in names], -1).squeeze(-1 if len(names) == 1 else ())
            found[layer] = pictures if pictures.dtype == "u4" else pictures.astype("f4")
    return header, found


def samples(shard, layers=None):
    """(description, layers) of every frame in a tar shard, in order."""
    with tarfile.open(shard) as archive:
        for member in archive:  # a frame, then its description
            data, ending = archive.extractfile(member).read(), member.name.split(".", 1)[1]
            if ending == "json":
                yield json.loads(data), frame
            else:
                _, frame = read_rff(data, layers) if ending == "rff" else read_exr(data, layers)
