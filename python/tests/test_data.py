"""Datasets from Python, on a small one that the command line makes."""

import multiprocessing
import shutil
import subprocess
import sys

import numpy as np
import pytest
from renderflow import data


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("data")

    def run(*arguments):
        done = subprocess.run([sys.executable, "-m", "renderflow", "dataset", *arguments], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    plan, whole, packed = (str(root / name) for name in ("plan.toml", "whole", "packed"))
    run("plan", "--seed", "5", "--sequences", "5", "--frames", "3", "--resolution", "32", "--spp", "1", "--denoise", "none", "--out", plan)
    run("render", "--plan", plan, "--out", whole)
    run("pack", whole, "--out", packed, "--profile", "compact", "--samples-per-shard", "3")
    return whole, packed


def test_folders(folders):
    whole, _ = folders
    dataset = data.Dataset(whole, "train", layers=["beauty", "depth"])
    assert len(dataset) == 3 * len(dataset.sequences()) and set(dataset[0]) == {"beauty", "depth"}
    assert len(data.Dataset(whole)) == 15
    assert dataset[-1]["beauty"].shape == (32, 32, 3)
    with pytest.raises(FileNotFoundError):
        data.Dataset(whole, "trian")


def test_what_was_put_aside_does_not_count(folders, tmp_path):
    whole = tmp_path / "whole"
    shutil.copytree(folders[0], whole)
    shutil.copytree(data.Dataset(whole).paths[0].parent, whole / "aside" / "train-seq-000000-1")
    assert len(data.Dataset(whole)) == len(data.Dataset(tmp_path)) == 15
    assert len(data.Dataset(whole / "aside")) == 3


def test_frames_are_in_the_order_of_their_numbers(tmp_path):
    for name in ("a/frame.10000.exr", "a/frame.9999.exr", "b/frame.0001.rff"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    names = [path.relative_to(tmp_path).as_posix() for path in data.Dataset(tmp_path).paths]
    assert names == ["a/frame.9999.exr", "a/frame.10000.exr", "b/frame.0001.rff"]


def test_shards_hold_what_folders_hold(folders):
    whole, packed = folders
    dataset = data.Dataset(whole, "train")
    found = data.shards(packed, "train")
    assert sum(shard.samples for shard in found) == len(dataset)
    frames = [frame for shard in found for _, frame in data.read_shard(shard.path)]
    assert len(frames) == len(dataset)
    for ours, packed_frame in zip(dataset, frames):
        assert np.array_equal(ours["object_id"], packed_frame["object_id"])
        np.testing.assert_allclose(ours["albedo"], packed_frame["albedo"], atol=0.01)
    for absent, reason in (("colour", "no frame has such a layer"), ("distance", "does not have this layer")):
        with pytest.raises(KeyError, match=reason):
            next(data.read_shard(found[0].path, [absent]))
    with pytest.raises(ValueError, match="no split 'trian', but .*train"):
        data.shards(packed, "trian")
    with pytest.raises(ValueError, match="is no folder of shards"):
        data.shards(whole, "train")
    # From any frame on.
    keys = [about["key"] for about, _ in data._samples(found[0].path)]
    for skip in range(found[0].samples + 1):
        assert [about["key"] for about, _ in data._samples(found[0].path, skip)] == keys[skip:]


def test_torch(folders):
    pytest.importorskip("torch")
    from renderflow.torch import FrameDataset, ShardDataset
    from torch.utils.data import DataLoader

    whole, packed = folders
    assert len(FrameDataset(whole, "train")) == len(ShardDataset(packed, "train"))
    sample = FrameDataset(whole, "train", layers=["beauty", "object_id"])[0]
    assert sample["beauty"].shape == (3, 32, 32) and str(sample["object_id"].dtype) == "torch.int64"
    dataset = ShardDataset(packed, "train", buffer=4)

    def keys(**options):
        return [key for batch in DataLoader(dataset, batch_size=2, **options) for key in batch["key"]]

    first = keys()
    assert len(first) == len(set(first)) == len(dataset) and first == keys()
    dataset.set_epoch(1)
    assert sorted(keys()) == sorted(first) and keys() != first
    # Workers that are spawned, as on macOS, on Windows, and by default from Python 3.14 on.
    context = multiprocessing.get_context("spawn")
    assert sorted(keys(num_workers=2, multiprocessing_context=context)) == sorted(first)
    # Workers that stay see the epoch change.
    loader = DataLoader(dataset, batch_size=2, num_workers=2, persistent_workers=True, multiprocessing_context=context)
    orders = []
    for epoch in (0, 1, 0):
        dataset.set_epoch(epoch)
        orders.append([key for batch in loader for key in batch["key"]])
        assert dataset.epoch == epoch and sorted(orders[-1]) == sorted(first)
    assert orders[0] == orders[2] != orders[1]
    with pytest.raises(KeyError, match="colour"):
        next(iter(ShardDataset(packed, "train", layers=["colour"])))


def test_processes_share_the_shards_evenly(folders):
    pytest.importorskip("torch")
    from renderflow.torch import ShardDataset
    from torch.utils.data import DataLoader

    _, packed = folders
    count = len(data.shards(packed, "train"))
    ranks = [ShardDataset(packed, "train", rank=rank, world=2) for rank in range(2)]
    seen = [[sample["key"] for sample in dataset] for dataset in ranks]
    assert len(seen[0]) == len(seen[1]) == len(ranks[0]) and not set(seen[0]) & set(seen[1])
    # A process that gets fewer batches than another would let it wait for ever.
    for epoch in range(4):
        for workers in (0, 2, 3):
            batches = []
            for dataset in ranks:
                dataset.set_epoch(epoch)
                batches.append([batch["key"] for batch in DataLoader(dataset, batch_size=2, num_workers=workers)])
            assert len(batches[0]) == len(batches[1])
            seen = [[key for batch in rank for key in batch] for rank in batches]
            assert len(seen[0]) == len(seen[1]) == len(ranks[0]) and not set(seen[0]) & set(seen[1])
    with pytest.raises(ValueError, match="fewer samples per shard"):
        ShardDataset(packed, "train", rank=0, world=count + 1)
