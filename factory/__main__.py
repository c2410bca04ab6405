"""Entry point of `factory` and `python -m factory`: removes the working directory from the import path.

Then it runs the command line. `-m` and an empty entry of `PYTHONPATH` add the directory; a dataset may contain a module
with the name of an imported one.
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
