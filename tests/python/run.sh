#!/bin/sh
# Checks by other people's programs, installed from the Python registry into target/python. RENDERFLOW_CYCLES_PYTHON may name a Python with bpy.
set -eu
cd "$(dirname "$0")/../.."
venv=target/python
[ -x $venv/bin/python ] || python3 -m venv $venv
$venv/bin/pip install -q "OpenEXR==3.5.3" "numpy==2.4.6" "zstandard==0.25.0" "pillow==13.0.0" "webdataset==1.0.2" "pycocotools==2.0.11"
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
# `make test-wheel` has built it.
$venv/bin/pip install -q --force-reinstall --no-deps target/wheels/renderflow-*.whl
renderflow=target/release/renderflow
$renderflow render --seed 1 --frames 1 --resolution 64 --spp 4 --out "$out"
$venv/bin/python tests/python/openexr_channels.py "$out/frame.0000.exr"

$renderflow dataset plan --seed 5 --sequences 4 --frames 4 --resolution 96 --spp 4 --out "$out/plan.json"
$renderflow dataset render --plan "$out/plan.json" --out "$out/data"
$renderflow dataset pack "$out/data" --out "$out/stored" --samples-per-shard 5
$renderflow dataset pack "$out/data" --out "$out/compact" --samples-per-shard 5 --profile compact
$venv/bin/python tests/python/compact_frames.py "$out/stored" "$out/compact"
$venv/bin/python tests/python/webdataset_shards.py "$out/stored"
$venv/bin/python tests/python/webdataset_shards.py "$out/compact"
for form in nerfstudio cosmos coco png; do
    $renderflow dataset export "$out/data" --to $form --out "$out/$form"
done
$venv/bin/python tests/python/exports.py "$out/nerfstudio" "$out/cosmos" "$out/coco" "$out/png"

# PyTorch's own index has a build without CUDA (0.2 GB); the registry's brings 4 GB of libraries with it.
if $venv/bin/python -c "import torch" 2>/dev/null ||
    $venv/bin/pip install -q --retries 0 --timeout 10 "torch==2.15.0" --index-url https://download.pytorch.org/whl/cpu 2>/dev/null ||
    $venv/bin/pip install -q "torch==2.15.0"; then
    for form in stored compact; do
        $venv/bin/python python/examples/show_batch.py "$out/$form" "$out/$form.png"
    done
    $venv/bin/python tests/python/same_batch.py "$out/stored.png" "$out/compact.png"
else
    echo "skipped: PyTorch cannot be installed here"
fi

bpy=${RENDERFLOW_CYCLES_PYTHON:-target/python-bpy/bin/python}
if [ ! -x "$bpy" ] && command -v python3.11 >/dev/null; then
    python3.11 -m venv target/python-bpy && target/python-bpy/bin/pip install -q "bpy==5.0.1" || true
fi
if [ -x "$bpy" ] && "$bpy" -c "import bpy" 2>/dev/null; then
    "$bpy" tests/python/blender_passes.py "$out/frame.0000.exr"
    sequence=$(find "$out/data" -name "frame.0001.exr" | sort | head -1)
    "$bpy" tests/python/blender_passes.py "$sequence"
else
    echo "skipped: Blender's module bpy 5.0.1 cannot be imported here (it is for Python 3.11 and needs X and GL libraries)"
fi
