"""The command ``renderflow``, and ``python -m renderflow``."""

import sys

from . import _renderflow


def main() -> None:
    """Runs the command line. It does not return."""
    _renderflow.main(["renderflow", *sys.argv[1:]])


if __name__ == "__main__":
    main()
