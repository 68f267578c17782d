"""What the package promises, on small scenes. Run after installing the wheel: pytest python/tests"""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import renderflow as rf


@pytest.fixture(scope="module")
def scene() -> rf.Scene:
    return rf.compose(seed=7, resolution=(64, 48), frames=3)


def command(*arguments: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", "renderflow", *arguments], capture_output=True, text=True, **options)


def test_a_frame_is_the_one_of_the_command_line(scene, tmp_path):
    scene.save(tmp_path / "scene.json")
    made = command("render", "--scene", str(tmp_path / "scene.json"), "--spp", "4", "--denoise", "none", "--out", str(tmp_path / "out"))
    assert made.returncode == 0, made.stderr
    for number in range(scene.frames):
        ours = rf.render(scene, number, spp=4, denoise="none")
        stored = rf.read_frame(tmp_path / "out" / f"frame.{number:04}.exr")
        assert ours.info["scene_hash"] == stored.info["scene_hash"] == scene.hash
        assert set(ours) == set(stored)
        for name, values in stored.items():
            assert ours[name].shape == values.shape and ours[name].dtype == values.dtype, name
            # Files hold half floats where the channel table says so.
            half = np.float16(np.minimum(ours[name], 65504)) if values.dtype == np.float32 else values
            equal = np.array_equal(ours[name], values) or np.array_equal(half.astype(values.dtype), values)
            assert equal, (number, name)


def test_shapes_types_and_no_copies(scene):
    frame = rf.render(scene, spp=2, denoise="none", distance=True, light_groups=2)
    for name in ("beauty", "albedo", "normal", "material", "raw", "light.0", "light.1"):
        assert frame[name].shape == (48, 64, 3) and frame[name].dtype == np.float32, name
    for name in ("depth", "distance", "alpha"):
        assert frame[name].shape == (48, 64) and frame[name].dtype == np.float32, name
    assert frame["object_id"].dtype == np.uint32 and frame["motion"].shape == (48, 64, 2)
    assert not any(values.flags.owndata for values in frame.values()), "arrays should view the renderer's memory"
    assert all(values.flags.writeable and values.flags.c_contiguous for values in frame.values())
    assert frame.display().dtype == np.uint8 and frame.exposure > 0
    np.testing.assert_allclose(frame["light.0"] + frame["light.1"], frame["raw"], rtol=1e-4, atol=1e-5)


def test_scenes_go_through_dicts(scene):
    description = scene.to_dict()
    assert rf.Scene.from_dict(description).hash == scene.hash
    description["materials"][0]["roughness"] = 0.123
    assert rf.Scene.from_dict(description).hash != scene.hash
    with pytest.raises(rf.Error, match="roughness"):
        description["materials"][0]["roughness"] = 7
        rf.Scene.from_dict(description)
    with pytest.raises(ValueError):
        description["materials"][0]["roughness"] = float("nan")
        rf.Scene.from_dict(description)


def test_numbers_and_arrays_of_numpy_are_numbers(scene):
    description = scene.to_dict()
    description["materials"][0]["roughness"] = np.float32(0.5)
    description["materials"][0]["base_color"] = np.array([0.25, 0.5, 1.0], np.float32)
    read = rf.Scene.from_dict(description).to_dict()["materials"][0]
    assert read["roughness"] == 0.5 and read["base_color"] == [0.25, 0.5, 1.0]
    with pytest.raises(ValueError):
        rf.Scene.from_dict({**description, "seed": np.float32("nan")})
    expected = rf.render(scene, spp=2, denoise="none")["beauty"]
    assert np.array_equal(rf.render(scene, spp=np.int64(2), denoise="none")["beauty"], expected)
    assert rf.compose(np.int64(7), resolution=np.int32(32)).resolution == (32, 32)


def flag(folder):
    """A description of a scene whose first object is a model in ``folder``."""
    (folder / "flag.obj").write_text("v -1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    description = rf.compose(seed=3, resolution=32).to_dict()
    description["objects"][0]["geometry"] = {"file": "flag.obj"}
    return description


def test_a_saved_scene_finds_its_files(tmp_path):
    models, elsewhere = tmp_path / "models", tmp_path / "elsewhere"
    models.mkdir(), elsewhere.mkdir()
    scene = rf.Scene.from_dict(flag(models), folder=models)
    expected = rf.gbuffer(scene)["object_id"]
    for folder in (models, elsewhere, tmp_path):
        scene.save(folder / "scene.json")
    # In the folder of the model, names stay.
    assert rf.load(models / "scene.json").hash == scene.hash
    assert np.array_equal(rf.gbuffer(rf.load(tmp_path / "scene.json"))["object_id"], expected)
    assert np.array_equal(rf.gbuffer(rf.load(elsewhere / "scene.json", allow_files=[models]))["object_id"], expected)
    with pytest.raises(rf.Error, match="leads out of the folder"):
        rf.gbuffer(rf.load(elsewhere / "scene.json"))


def test_one_folder_that_is_allowed_is_no_list_of_letters(tmp_path):
    models, elsewhere = tmp_path / "models", tmp_path / "elsewhere"
    models.mkdir(), elsewhere.mkdir()
    description = flag(models)
    description["objects"][0]["geometry"] = {"file": str(models / "flag.obj")}
    for allowed in (str(models), models, [models]):
        rf.gbuffer(rf.Scene.from_dict(description, folder=elsewhere, allow_files=allowed))
    # The first letter is "/", which would allow every file.
    with pytest.raises(rf.Error, match="leads out of the folder"):
        rf.gbuffer(rf.Scene.from_dict(description, folder=elsewhere, allow_files=str(elsewhere)))


def test_wrong_arguments_are_named(scene, tmp_path):
    with pytest.raises(IndexError, match="frame 3 of a scene with 3 frames"):
        rf.render(scene, 3)
    with pytest.raises(ValueError, match="sharpness is no setting"):
        rf.render(scene, spp=1, sharpness=2)
    with pytest.raises(ValueError, match="denoise: .magic. is none of"):
        rf.render(scene, spp=1, denoise="magic")
    with pytest.raises(ValueError, match="at least 1"):
        rf.render(scene, spp=0)
    with pytest.raises(ValueError):
        rf.render(scene, spp=1, clamp_indirect=float("inf"))
    for name, value in {"light_groups": "two", "spp": 1.5, "max_bounces": -1}.items():
        with pytest.raises(ValueError, match=f"^{name}: found "):
            rf.render(scene, **{name: value})
    with pytest.raises(rf.Error, match="spp"):
        rf.render(scene, spp=0x7FFFFFFF, denoise="none")
    with pytest.raises(rf.Error, match="absent.glb"):
        rf.load(tmp_path / "absent.glb")
    with pytest.raises(OSError):
        rf.read_frame(tmp_path / "absent.exr")
    with pytest.raises(rf.Error):
        rf.read_frame(b"no frame")
    with pytest.raises(ValueError, match="height, width, 3"):
        rf.psnr(np.zeros((8, 8, 4)), np.zeros((8, 8, 4)))
    with pytest.raises(ValueError):
        rf.ssim(np.zeros((16, 16, 3)), np.zeros((16, 17, 3)))
    # A crop beside the picture is equal to everything.
    for metric in (rf.psnr, rf.ssim, rf.flip):
        with pytest.raises(ValueError, match="pictures with pixels|picture without pixels"):
            metric(np.zeros((0, 16, 3)), np.zeros((0, 16, 3)))


@pytest.mark.skipif(sys.platform != "linux", reason="the limit of an address space")
def test_cameras_and_animations_of_a_file(tmp_path):
    """A triangle that rises by 1 m in a second, and a camera 3 m in front of it."""
    corners = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    times, places = np.array([0, 1], np.float32), np.array([[0, 0, 0], [0, 1, 0]], np.float32)
    parts = [corners.tobytes(), times.tobytes(), places.tobytes()]
    views = [{"buffer": 0, "byteOffset": sum(map(len, parts[:i])), "byteLength": len(part)} for i, part in enumerate(parts)]
    model = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"camera": 0, "translation": [0, 0.5, 3]}],
        "cameras": [{"name": "front", "type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "animations": [
            {
                "name": "rise",
                "samplers": [{"input": 1, "output": 2}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
            }
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [-1, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
            {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
        "bufferViews": views,
        "buffers": [{"uri": "data.bin", "byteLength": sum(map(len, parts))}],
    }
    (tmp_path / "model.gltf").write_text(json.dumps(model))
    (tmp_path / "data.bin").write_bytes(b"".join(parts))
    still = rf.load(tmp_path / "model.gltf", camera="front", resolution=(32, 32))
    moving = rf.load(tmp_path / "model.gltf", camera=0, animation="rise", resolution=(32, 32))
    assert still.frames == 1 and moving.frames == 24
    # The triangle leaves the picture upwards.
    seen = [rf.gbuffer(moving, frame)["object_id"] == 1 for frame in (0, 12)]
    rows = [np.nonzero(ids.any(axis=1))[0].mean() for ids in seen]
    assert rows[1] < rows[0] - 4, rows
    with pytest.raises(rf.Error, match="front"):
        rf.load(tmp_path / "model.gltf", camera="back")


def test_frames_beyond_memory_are_refused():
    code = (
        "import renderflow as rf, resource\n"
        "resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))\n"
        "scene = rf.compose(seed=3, resolution=16384)\n"
        "for make in (lambda: rf.render(scene, spp=1), lambda: rf.gbuffer(scene), lambda: rf.deferred(scene)):\n"
        "    try: make()\n"
        "    except rf.Error as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.count("a frame of 16384 x 16384 pixels") == 3, done.stdout + done.stderr


def test_layers_of_a_file(scene, tmp_path):
    scene.save(tmp_path / "scene.json")
    out = str(tmp_path / "out")
    assert command("render", "--scene", str(tmp_path / "scene.json"), "--frames", "1", "--spp", "1", "--out", out).returncode == 0
    path = tmp_path / "out" / "frame.0000.exr"
    assert set(rf.read_frame(path, ["depth", "albedo"])) == {"depth", "albedo"}
    assert set(rf.read_frame(path.read_bytes(), ["alpha"])) == {"alpha"}
    assert set(rf.read_frame(path, "depth")) == {"depth"}
    with pytest.raises(KeyError, match="colour"):
        rf.read_frame(path, ["colour"])
    with pytest.raises(KeyError, match="distance"):
        rf.read_frame(path, ["distance"])


def test_metrics_agree_with_formulae():
    rng = np.random.default_rng(5)
    a = rng.random((40, 50, 3), np.float32)
    b = np.clip(a + 0.1 * rng.standard_normal(a.shape, np.float32), 0, 1)
    assert rf.psnr(a, b) == pytest.approx(-10 * np.log10(np.mean((a - b) ** 2)), abs=1e-4)
    assert rf.psnr(a, a) == float("inf") and rf.ssim(a, a) == pytest.approx(1) and rf.flip(a, a) == 0
    mask = np.zeros((40, 50))
    mask[10:20, 5:30] = 1
    inside = mask > 0
    assert rf.psnr(a, b, mask) == pytest.approx(-10 * np.log10(np.mean((a[inside] - b[inside]) ** 2)), abs=1e-4)
    assert 0 < rf.ssim(a, b) < 1 and 0 < rf.flip(a, b) < 1
    # Bytes are no values in 0..1.
    for metric in (rf.psnr, rf.ssim, rf.flip):
        with pytest.raises(ValueError, match="divide bytes by 255"):
            metric(rf.to_display(a), b)
        with pytest.raises(ValueError, match="not int64"):
            metric(a, np.ones(a.shape, np.int64))
    # Any array of floats will do.
    assert rf.psnr(a.astype(np.float64)[::-1], b[::-1]) == pytest.approx(rf.psnr(a, b), abs=1e-4)
    skimage = pytest.importorskip("skimage.metrics")
    theirs = skimage.structural_similarity(
        a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=2
    )
    assert rf.ssim(a, b) == pytest.approx(theirs, abs=1e-5)


def test_the_network_and_deferred_shading(scene):
    network = rf.Neural()
    assert network.parameters > 100_000
    truth = rf.render(scene, spp=256, denoise="none").display() / 255
    exposure = rf.gbuffer(scene).exposure

    def error(picture):
        return rf.psnr(rf.to_display(picture, exposure) / 255, truth)

    noisy = rf.render(scene, spp=2, denoise="none")["beauty"]
    with_rays = network.render(scene, rays=2, oidn=None)
    assert error(with_rays) > error(noisy) + 1
    assert np.isfinite(network.render(scene)).all()
    assert error(rf.deferred(scene)) > 15
    if rf.denoiser() is not None:
        frame = rf.render(scene, spp=2, denoise="none")
        clean = rf.denoise(frame["raw"], frame["guide_albedo"], frame["guide_normal"])
        assert error(clean) > error(noisy) + 1
    with pytest.raises(rf.Error):
        rf.Neural(__file__)
    with pytest.raises(rf.Error, match="device vulkan:7: "):
        rf.Neural(device="vulkan:7")
    with pytest.raises(ValueError, match="device gpu: expected cpu"):
        rf.Neural(device="gpu")


def test_threads_share_a_scene(scene):
    expected = rf.render(scene, 1, spp=2, denoise="none")["beauty"]
    made = [None] * 4

    def work(i):
        made[i] = rf.render(scene, i % 3, spp=2, denoise="none")["beauty"]

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert np.array_equal(made[1], expected) and np.array_equal(made[0], made[3])


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_stops_a_render():
    code = (
        "import renderflow as rf, sys\n"
        "scene = rf.compose(seed=3, resolution=512)\n"
        "rf.gbuffer(scene); print('ready', flush=True)\n"
        "try: rf.render(scene, spp=1 << 20, denoise='none')\n"
        "except KeyboardInterrupt: print('stopped', flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=60)[0] == "stopped\n" and process.returncode == 0


def test_the_command_line_is_inside(tmp_path):
    version = command("--version")
    assert version.returncode == 0 and version.stdout.split() == ["renderflow", rf.__version__]
    assert command("render", "--no-such-option").returncode == 2
    made = command("compose", "--seed", "7", "--out", str(tmp_path / "scene.json"))
    assert made.returncode == 0 and json.loads((tmp_path / "scene.json").read_text())["frames"] >= 1
    assert command("render", "--scene", str(tmp_path / "absent.json"), "--out", str(tmp_path / "o")).returncode == 1


def _in_a_fork(seed):
    try:
        rf.gbuffer(rf.compose(seed, resolution=16))
    except rf.Error as error:
        return str(error)
    return "rendered"


def test_forked_processes_are_refused():
    if "fork" not in multiprocessing.get_all_start_methods():
        pytest.skip("there is no fork here")
    rf.gbuffer(rf.compose(7, resolution=16))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert "spawn" in pool.apply_async(_in_a_fork, (8,)).get(60)
    for frames in (0, 4_000_000_000):
        with pytest.raises(rf.Error, match="frames"):
            rf.compose(7, frames=frames)
