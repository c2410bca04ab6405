"""`factory bench serve`: measures the web page of a dataset."""

from __future__ import annotations

from factory.bench.reading.serve import bench_serve
from factory.commands.other.bench_tables import show_serve
from factory.support.terminal import print_result
from schemas.storage.place import Place
from schemas.support.extras import require_package


def serve(root: Place, repeats: int, tabs: int, seconds: float, as_json: bool) -> None:
    """Executes `factory bench serve`."""
    require_package("starlette", "`factory bench serve`")
    print_result(bench_serve(root, repeats, tabs, seconds), as_json, show_serve)
