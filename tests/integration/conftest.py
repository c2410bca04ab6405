"""Small real datasets and other fixtures that several integration tests share."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from coordinator.validation.validator import Validator
from factory.dataset.reader import Dataset
from schemas.storage.object_path import ObjectPath
from schemas.terms import Recording
from tests.acceptance.factory_cli import FactoryCli
from tests.builders.driven import driven_recordings
from tests.builders.evaluation import archive_drives
from tests.builders.object_server import ObjectServer
from tests.builders.rigs import render_rigged
from tests.builders.shared import build_once
from tests.builders.shared_validator import SharedValidator
from tests.builders.store_relay import StoreRelay


@pytest.fixture(scope="session")
def drives(shared: Path) -> Dataset:
    """Three archived episodes in the room of boxes: one for training, two for testing; tests only read them."""
    return Dataset(build_once(shared / "drives-3", archive_drives))


@pytest.fixture(scope="session")
def recordings(shared: Path) -> dict[Recording, Path]:
    """Datasets of frames and of states with the same two drives; tests only read them. Needs an EGL driver."""
    return driven_recordings(shared)


@pytest.fixture(scope="session")
def rigged(factory: FactoryCli, shared: Path, recordings: dict[Recording, Path]) -> Path:
    """The two drives of `recordings` with the measurements of a small rig; tests only read them."""
    build = functools.partial(render_rigged, states=recordings[Recording.STATES], factory=factory)
    return build_once(shared / "driven-rigged", build)


@pytest.fixture(scope="session")
def checker() -> Iterator[SharedValidator]:
    """A validator that the coordinators and repairs of all test modules use one after another."""
    with Validator() as validator:
        yield SharedValidator(validator)


@pytest.fixture
def relay(object_store: ObjectServer) -> Iterator[StoreRelay]:
    """A relay to the object store that can inject failures."""
    with StoreRelay(object_store.endpoint) as between:
        yield between


@pytest.fixture
def store(bucket_url: Callable[[], str], relay: StoreRelay, monkeypatch: pytest.MonkeyPatch) -> ObjectPath:
    """A new bucket behind the relay."""
    url = bucket_url()
    monkeypatch.setenv("AWS_ENDPOINT_URL", relay.endpoint)
    return ObjectPath.at(f"{url}/run")
