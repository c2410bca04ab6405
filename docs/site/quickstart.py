"""Executes a notebook in an empty folder and saves it with its outputs, without the parts that differ between runs."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode


def execute(path: Path) -> None:
    """Runs all cells of the notebook at `path` with this Python, and writes the notebook with their outputs."""
    notebook = nbformat.read(path, as_version=4)
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ["COLUMNS"] = "100"
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=1800, resources={"metadata": {"path": folder}}).execute()
        _tidy(notebook, folder)
    path.write_text(nbformat.writes(notebook) + "\n", encoding="utf-8")


def _tidy(notebook: NotebookNode, folder: str) -> None:
    """Removes the path of the temporary folder, terminal colours and messages on stderr from the outputs."""
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    for number, cell in enumerate(notebook.cells, 1):
        cell.id, cell.metadata = f"cell-{number:02d}", {}
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
            for output in cell.outputs:
                if "text" in output:
                    output.text = re.sub(r"\x1b\[[0-9;]*m", "", output.text).replace(f"{folder}/", "")


if __name__ == "__main__":
    execute(Path(sys.argv[1]))
