"""Finds Intel Open Image Denoise in the package pyoidn."""

import importlib.util
import os
from pathlib import Path

VARIABLE = "RENDERFLOW_OIDN"


def find() -> None:
    """Names the library of pyoidn to the program, unless somebody has named one."""
    if os.environ.get(VARIABLE):
        return
    found = importlib.util.find_spec("pyoidn")
    for folder in (found.submodule_search_locations or []) if found else []:
        library = Path(folder) / "oidn" / "lib" / "libOpenImageDenoise.so.2"
        if library.is_file():
            os.environ[VARIABLE] = str(library)
            return
