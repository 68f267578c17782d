"""compact_frames.py STORED COMPACT: the same dataset packed both ways. What numpy reads of the compact frames must be what OpenEXR reads of the
others, within the precision that renderer/frame/src/compact.rs states."""
import json
import pathlib
import sys

import numpy as np
from numpy_reader import read_rff, samples

UNIT = 0.5 / 255 + 1e-6
stored, compact = map(pathlib.Path, sys.argv[1:])
shards = [s["file"] for s in json.loads((stored / "manifest.json").read_text())["shards"] if s["kind"] == "frames"]


def srgb(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-6) ** (1 / 2.4) - 0.055)


def degrees(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))


count, worst = 0, {}
for shard in shards:
    for (whole, exr), (small, rff) in zip(samples(stored / shard), samples(compact / shard), strict=True):
        assert whole["key"] == small["key"] and whole["camera"] == small["camera"] and small["bytes"] < whole["bytes"]
        assert set(rff) >= {"beauty", "alpha", "albedo", "normal", "depth", "material", "motion", "motion_prev", "object_id", "material_id"}
        hit = np.isfinite(exr["depth"])
        errors = {}
        for name, values in rff.items():
            now, then = values.astype("f8"), exr[name].astype("f8")
            assert now.shape == then.shape and not np.isnan(now).any(), name
            if name == "normal":
                assert (now[~hit] == 0).all() and (np.abs(np.linalg.norm(now[hit], axis=-1) - 1) < 1e-6).all()
                # The halves of the other file are 0.03 degrees off as well.
                errors[name] = (degrees(now[hit], then[hit]), 0.08)
            elif name == "depth":
                assert (np.isposinf(now) == ~hit).all()
                errors[name] = (np.abs(now[hit] / then[hit] - 1), 2.0**-13)
            elif name == "albedo":
                errors[name] = (np.abs(srgb(now) - srgb(then)), UNIT + 0.0015)
            elif name == "through":
                seen = np.linalg.norm(then, axis=-1) > 0.5
                assert (now[~seen] == 0).all() and (np.abs(np.linalg.norm(now[seen], axis=-1) - 1) < 1e-6).all()
                errors[name] = (degrees(now[seen], then[seen]), 0.08)
            elif name in ("alpha", "material", "transmittance"):
                errors[name] = (np.abs(now - then), UNIT + 2.0**-11)
            else:
                errors[name] = (np.abs(now - then), 0)
        for name, (error, bound) in errors.items():
            error = error.max(initial=0)
            assert error <= bound, f"{small['key']} {name}: {error} > {bound}"
            worst[name] = max(worst.get(name, 0), error)
        count += 1
assert count > 0
try:
    read_rff(b"\x76\x2f\x31\x01" + bytes(100))
    raise SystemExit("an OpenEXR file was read as a compact one")
except ValueError:
    pass
print(count, "compact frames agree with OpenEXR; largest differences:", ", ".join(f"{k} {v:.2g}" for k, v in sorted(worst.items())))
