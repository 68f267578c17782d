#!/usr/bin/env python3
"""Writes the reference of the Python package as HTML: python_api.py OUT. It needs pdoc and numpy, but neither the compiled
module nor PyTorch.

The stubs of the compiled module (`_renderflow.pyi`) stand in for it, and empty classes stand in for PyTorch's."""

import shutil
import sys
import tempfile
import types
from pathlib import Path

import pdoc

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "renderflow"


def stand_in_for_torch():
    names = ["torch", "torch.nn", "torch.nn.functional", "torch.utils", "torch.utils.data"]
    modules = {name: types.ModuleType(name) for name in names}
    modules["torch"].utils = modules["torch.utils"]
    modules["torch.utils"].data = modules["torch.utils.data"]
    modules["torch"].nn = modules["torch.nn"]
    modules["torch.nn"].functional = modules["torch.nn.functional"]
    modules["torch.nn"].Module = type("Module", (), {"__module__": "torch.nn"})
    modules["torch.nn"].Conv2d = type("Conv2d", (), {"__module__": "torch.nn"})
    modules["torch"].Tensor = type("Tensor", (), {"__module__": "torch"})
    for name in ("Dataset", "IterableDataset"):
        anything = classmethod(lambda cls, item: cls)
        setattr(
            modules["torch.utils.data"], name, type(name, (), {"__class_getitem__": anything, "__module__": "torch.utils.data"})
        )
    modules["torch.utils.data"].get_worker_info = lambda: None
    sys.modules.update(modules)


def main(out):
    stand_in_for_torch()
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder) / "renderflow"
        shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
        stubs = package / "_renderflow.pyi"
        version = '__version__ = ""\ntiers = dict\n'
        (package / "_renderflow.py").write_text("from __future__ import annotations\n" + stubs.read_text() + version)
        stubs.unlink()
        sys.path.insert(0, folder)
        pdoc.render.configure(docformat="restructuredtext", show_source=False)
        pdoc.pdoc("renderflow", "renderflow.data", "renderflow.torch", "renderflow.fusion", output_directory=Path(out))


if __name__ == "__main__":
    main(*sys.argv[1:])
