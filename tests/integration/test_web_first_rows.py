"""The page of a large table shows its first rows while the columns of all rows are read."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from coordinator.status.address import parse_address
from coordinator.status.server import HttpServer
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.web.access import Access
from factory.web.app import create_app
from factory.web.figures.store import StatisticsStore
from factory.web.pages.episodes import LARGE_ROWS
from factory.web.start import make_context
from factory.web.table import read_first_rows
from factory.web.workspace import CurrentTable, Workspace
from schemas.protocol.administration import AdminReply, AdminRequest
from tests.builders.dataset import make_dataset
from tests.builders.web import WebClient
from tests.builders.wire_worker import until


def make_table(root: Path, rows: int) -> None:
    """Writes a dataset of two episodes, and a table that repeats their rows until it has `rows` rows."""
    make_dataset(root, 2)
    table = pq.read_table(root / "metadata.parquet")
    whole = table.take(pa.array(np.arange(rows) % len(table)))
    numbers = pa.array(np.arange(1, rows + 1)).cast(table.schema.field("index").type)
    names = pa.array([f"ep_{number:06d}" for number in range(1, rows + 1)])
    for name, values in (("index", numbers), ("episode_id", names)):
        place = whole.schema.get_field_index(name)
        whole = whole.set_column(place, name, values.cast(table.schema.field(name).type))
    pq.write_table(whole, root / "metadata.parquet")


def refuse(_request: AdminRequest) -> AdminReply:
    raise AssertionError


@contextmanager
def page_with_slow_table(root: Path, may_read: threading.Event) -> Iterator[WebClient]:
    """Serves a dataset; its table is not read before the event `may_read` is set."""

    def read() -> Dataset:
        may_read.wait(120)
        return Dataset(root)

    workspace, address = Workspace(site_of(str(root))), parse_address("127.0.0.1:0", None)
    workspace._table = CurrentTable(read, lambda: 1, 1.0)
    context = make_context(workspace, refuse, StatisticsStore(str(root)))
    app = create_app(context, address, Access("token", reads_openly=True))
    with HttpServer(app, address, "the web page") as server:
        yield WebClient(server.url.removeprefix("http://"), "token")


def test_a_large_table_shows_its_first_rows_until_it_is_read(tmp_path):
    make_table(tmp_path, LARGE_ROWS)
    may_read = threading.Event()
    with page_with_slow_table(tmp_path, may_read) as client:
        first = client.ask("/episodes").text
        assert f"The table of {LARGE_ROWS:,} episodes is being read" in first
        assert first.count("<tr>") == 51
        assert '<a href="/episodes/ep_000050">' in first
        may_read.set()
        until(lambda: "is being read" not in client.ask("/episodes").text)
        assert f"{LARGE_ROWS} of {LARGE_ROWS} episodes" in client.ask("/episodes").text


def test_first_rows_are_those_of_the_dataset_and_a_damaged_table_has_none(tmp_path):
    make_table(tmp_path, 120)
    found = read_first_rows(tmp_path, 50)
    assert found is not None
    assert found.total == 120
    expected = [{name: row[name] for name in found.rows[0]} for row in list(Dataset(tmp_path).rows())[:50]]
    assert found.rows == expected
    (tmp_path / "metadata.parquet").write_bytes(b"PAR1")
    assert read_first_rows(tmp_path, 50) is None
