"""Runs the Python snippets that a Markdown file prints, in the folder for which they are written.

Does not import this project. Snippets are those of this repository and of exports that the caller has just made.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

_BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def snippets_of(page: Path) -> list[str]:
    """Returns the Python snippets of a Markdown file."""
    return _BLOCK.findall(page.read_text(encoding="utf-8"))


def run_snippets(page: Path, folder: Path, package: str) -> int:
    """Runs the snippets of a page that import a package, with the interpreter of the caller.

    Args:
        page: Markdown file.
        folder: working directory of the snippets.
        package: name that a snippet imports.

    Returns:
        The number of snippets.

    Raises:
        AssertionError: no snippet imports the package, or one fails; the message has its output.
    """
    chosen = [code for code in snippets_of(page) if re.search(rf"\b(import|from) {package}\b", code)]
    assert chosen, f"{page} has no snippet for {package}"
    for code in chosen:
        done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, f"{page}:\n{code}\n{done.stderr[-2000:]}"
    return len(chosen)
