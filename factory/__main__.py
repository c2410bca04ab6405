"""Entry point of `factory` and `python -m factory`: removes the working directory from the import path.

Then it runs the command line. `python -m` and an empty entry in `PYTHONPATH` add the working directory to the import
path. If it stayed there, Python would import a file such as `json.py` in it instead of the real module.
"""

import os
import sys

_HERE = os.getcwd()  # noqa: PTH109 - the directory could contain a pathlib.py
if not __file__.startswith(os.path.join(_HERE, "factory", "")):  # noqa: PTH118
    sys.path[:] = [entry for entry in sys.path if entry not in {"", _HERE}]

from factory.cli.main import main  # noqa: E402

__all__ = ["main"]

if __name__ == "__main__":
    main()
