"""Entry point of the command `factory`: checks the product's packages, then runs the command line."""

from __future__ import annotations

import sys

from minivla.packages import require_own_packages


def main() -> None:
    """Runs the command line and exits with its code.

    The exit code is 2 when a foreign package hides a package of the product.
    """
    try:
        require_own_packages()
    except ImportError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(2)
    from factory.__main__ import main as run

    run()
