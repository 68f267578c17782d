#!/bin/sh
# Installs the wheel into a fresh environment, where no compiler and no source is needed, and tests it there.
set -eu
cd "$(dirname "$0")/../.."
venv=target/python-wheel-test
rm -rf $venv
python3 -m venv $venv
$venv/bin/pip install -q "pytest==9.2.0" "scikit-image" "pyoidn==2.5.1.0" target/wheels/renderflow-*.whl
$venv/bin/pip install -q "torch==2.15.0" --index-url https://download.pytorch.org/whl/cpu 2>/dev/null ||
    $venv/bin/pip install -q "torch==2.15.0" || echo "skipped: PyTorch cannot be installed here"
$venv/bin/pip install -q "nbclient==0.11.0" "ipykernel==7.4.0" "matplotlib==3.11.2" || echo "skipped: the notebooks' packages cannot be installed here"
$venv/bin/python -m pytest -q -rs python/tests
