"""webdataset_shards.py SHARDS: the webdataset package finds every sample that the manifest counts, with both of its files."""
import hashlib
import json
import pathlib
import sys

import webdataset

folder = pathlib.Path(sys.argv[1])
manifest = json.loads((folder / "manifest.json").read_text())
keys = set()
for kind in ("frames", "sequences"):
    for split in sorted({shard["split"] for shard in manifest["shards"]}):
        shards = [shard for shard in manifest["shards"] if shard["split"] == split and shard["kind"] == kind]
        urls, found = [str(folder / shard["file"]) for shard in shards], 0
        for sample in webdataset.WebDataset(urls, shardshuffle=False):
            about = json.loads(sample["json"])
            ending = about["file"] if kind == "frames" else "hdr"
            assert sample["__key__"] == about["key"] and "." not in about["key"] and about["split"] == split, about
            assert len(sample[ending]) > 0 and (kind, about["key"]) not in keys, about["key"]
            if kind == "frames":
                assert len(sample[ending]) == about["bytes"]
                keys.add(("environment", about["environment"]["key"]))
            keys.add((kind, about["key"]))
            found += 1
        wanted = manifest["samples" if kind == "frames" else "sequences"][split]
        assert found == wanted == sum(shard["samples"] for shard in shards), f"{found} of {wanted} {kind} of {split}"
frames = sum(kind == "frames" for kind, _ in keys)
assert {key for kind, key in keys if kind == "environment"} == {key for kind, key in keys if kind == "sequences"}
print("webdataset", webdataset.__version__, "reads", frames, "frames and", sum(kind == "sequences" for kind, _ in keys), "sequences")
