"""Entry point of `factory` and `python -m factory`: takes the working directory off the import path, then runs.

`-m`, and an empty entry of `PYTHONPATH`, put it there; a dataset may hold a module with the name of one that we import.
"""

import os
import sys

_HERE = os.getcwd()  # noqa: PTH109 - pathlib could be imported from there
if not __file__.startswith(os.path.join(_HERE, "factory", "")):  # noqa: PTH118
    sys.path[:] = [entry for entry in sys.path if entry not in {"", _HERE}]

from factory.cli.main import main  # noqa: E402

__all__ = ["main"]

if __name__ == "__main__":
    main()
