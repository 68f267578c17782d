#!/bin/sh
# Checks by other people's programs, installed from the Python registry into target/python.
set -eu
cd "$(dirname "$0")/../.."
venv=target/python
[ -x $venv/bin/python ] || python3 -m venv $venv
$venv/bin/pip install -q "OpenEXR==3.5.3" "numpy"
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
target/release/renderflow render --seed 1 --frames 1 --resolution 64 --spp 4 --out "$out"
$venv/bin/python tests/python/openexr_channels.py "$out/frame.0000.exr"
