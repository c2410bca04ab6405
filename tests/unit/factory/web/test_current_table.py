"""The table of a web page is updated when its files change, and no request waits while they are read."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.web.workspace import CurrentTable
from schemas.errors import FactoryError
from tests.builders.dataset import make_dataset


def hourly() -> Callable[[], float]:
    """Returns a clock that advances by an hour at each reading."""
    hours = count(1)
    return lambda: 3600.0 * next(hours)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("current") / "data"
    make_dataset(root, 2)
    return root


def test_equal_versions_give_the_same_table_and_another_version_a_new_one(root):
    versions: Iterator[int] = iter((1, 1, 2))
    current = CurrentTable(lambda: Dataset(root), lambda: next(versions), 1.0, hourly())
    first = current.get()
    assert current.get() is first
    assert current.get() is not first


def test_a_request_during_a_long_reading_gets_the_previous_table(root):
    finish, readings = threading.Event(), count()

    def read() -> Dataset:
        if next(readings) > 0:
            assert finish.wait(60)
        return Dataset(root)

    versions: Iterator[int] = iter((1, 2, 2))
    current = CurrentTable(read, lambda: next(versions), 1.0, hourly())
    first = current.get()
    assert current.get() is first
    assert current.get() is first
    finish.set()
    for thread in threading.enumerate():
        if thread.name == "table":
            thread.join(60)
    assert current.get() is not first


def test_missing_files_raise_an_error_until_they_exist(root, tmp_path):
    place = tmp_path / "later"
    current = CurrentTable(lambda: Dataset(place), lambda: None, 1.0, hourly())
    with pytest.raises(FactoryError):
        current.get()
    place.symlink_to(root)
    assert len(current.get()) == 2
