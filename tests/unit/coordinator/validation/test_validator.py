"""The sandbox around validation: real children, real limits, hostile bundles."""

from __future__ import annotations

import io
import os
import signal
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from coordinator.validation.messages import MAX_TASKS, ValidationTask, ValidatorLimits
from coordinator.validation.validator import Validator
from schemas.errors import InvalidBundle, TransientError
from schemas.terms import Recording
from tests.builders.bundle import bundle_bytes, job_for, parts_for
from tests.builders.dataset import chair

_TRIES = 50


def child_processes() -> set[int]:
    """Returns the child processes of all threads of this process."""
    return {int(pid) for path in Path("/proc/self/task").glob("*/children") for pid in path.read_text().split()}


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    path = tmp_path / "ep_000001.part"
    path.write_bytes(bundle_bytes())
    return path


@pytest.fixture(scope="module")
def validator() -> Iterator[Validator]:
    with Validator() as opened:
        yield opened


def test_valid_bundle_gives_the_row_of_the_episode(validator: Validator, bundle: Path) -> None:
    row = validator.check(bundle, job_for(), (chair(),))
    assert (row.episode_id, row.num_steps, row.file_bytes) == ("ep_000001", 12, bundle.stat().st_size)


def test_a_states_recording_is_validated_in_the_sandbox(validator: Validator, tmp_path: Path) -> None:
    job = job_for(record=Recording.STATES)
    path = tmp_path / "x.part"
    path.write_bytes(parts_for(job).write())
    assert validator.check(path, job, (chair(),)).num_steps == 12


def test_all_violations_are_returned_by_the_validating_process(validator: Validator, tmp_path: Path) -> None:
    path = tmp_path / "x.part"
    path.write_bytes(parts_for().with_rollout(steps_visible=3, final_ne_m=9.0).write())
    with pytest.raises(InvalidBundle) as refused:
        validator.check(path, job_for(2))
    text = str(refused.value)
    assert "job.index" in text
    assert "steps_visible 3" in text
    assert "final_ne_m is 9" in text


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"\x00" * 5000, bundle_bytes()[:-100]])
def test_random_bytes_are_refused(validator: Validator, tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "x.part"
    path.write_bytes(damage)
    with pytest.raises(InvalidBundle):
        validator.check(path, job_for())


def test_missing_file_is_refused(validator: Validator, tmp_path: Path) -> None:
    with pytest.raises(InvalidBundle, match="cannot be read"):
        validator.check(tmp_path / "nothing", job_for())


def test_zip_bomb_is_refused(validator: Validator, tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("meta.json", b"0" * (64 << 20))
    path = tmp_path / "x.part"
    path.write_bytes(buffer.getvalue())
    with pytest.raises(InvalidBundle, match="is compressed by the zip"):
        validator.check(path, job_for())


def test_a_child_that_exceeds_its_time_limit_is_replaced_and_its_bundle_is_refused(bundle: Path) -> None:
    with Validator(limits=ValidatorLimits(wall_s=0.001)) as validator:
        with pytest.raises(InvalidBundle, match="2 validating processes died"):
            validator.check(bundle, job_for())
        with pytest.raises(InvalidBundle, match="validation crashed"):
            validator.check(bundle, job_for())


def test_repeated_child_crashes_do_not_fill_the_log(bundle: Path) -> None:
    with Validator(limits=ValidatorLimits(wall_s=0.001), clock=lambda: 0.0) as validator, capture_logs() as lines:
        for _ in range(2):
            with pytest.raises(InvalidBundle, match="2 validating processes died"):
                validator.check(bundle, job_for())
    assert [line["event"] for line in lines].count("validator_died") == 1


def test_a_bundle_is_not_refused_if_a_signal_from_outside_ends_the_validating_process(bundle: Path) -> None:
    before = child_processes()
    with Validator() as validator, ThreadPoolExecutor(1) as pool:
        for _ in range(_TRIES):
            validator.check(bundle, job_for())
            (child,) = child_processes() - before
            os.kill(child, signal.SIGSTOP)
            checking = pool.submit(validator.check, bundle, job_for())
            time.sleep(0.1)
            os.kill(child, signal.SIGTERM)
            os.kill(child, signal.SIGCONT)
            error = checking.exception()
            if error is not None:  # without an error, the signal came before the bundle, and a new process validated it
                break
    assert isinstance(error, TransientError)
    assert "a signal from outside ended the validating process" in str(error)


def test_a_child_that_cannot_start_is_a_machine_error_and_not_a_bundle_error(bundle: Path) -> None:
    tight = ValidatorLimits.model_construct(memory_bytes=1 << 20, cpu_s=10, wall_s=10.0)
    with Validator(limits=tight) as validator, pytest.raises(TransientError, match="does not start"):
        validator.check(bundle, job_for())


def test_a_child_that_a_batch_system_ends_during_its_start_is_not_blamed_on_the_memory(bundle: Path) -> None:
    before = child_processes()
    with Validator() as validator, ThreadPoolExecutor(1) as pool:
        checking = pool.submit(validator.check, bundle, job_for())
        while not (started := child_processes() - before):
            time.sleep(0.001)
        for child in started:
            os.kill(child, signal.SIGTERM)  # as scancel does; the child imports for longer than a millisecond
        error = checking.exception()
    assert isinstance(error, TransientError)
    assert "a signal from outside, such as that of a batch system, ended the validating process" in str(error)
    assert "memory" not in str(error)


def test_a_closed_validator_raises_an_error(bundle: Path) -> None:
    validator = Validator()
    validator.close()
    with pytest.raises(TransientError, match="closed"):
        validator.check(bundle, job_for())


def test_many_threads_share_the_children(bundle: Path) -> None:
    with Validator(children=2) as validator, ThreadPoolExecutor(6) as pool:
        rows = list(pool.map(lambda _: validator.check(bundle, job_for()), range(12)))
    assert {row.episode_id for row in rows} == {"ep_000001"}


def test_bundles_that_follow_each_other_use_one_child(bundle: Path) -> None:
    before = child_processes()
    with Validator(children=3) as validator:
        for _ in range(3):
            validator.check(bundle, job_for())
        assert len(child_processes() - before) == 1


def test_each_bundle_of_an_order_has_a_separate_verdict(validator: Validator, bundle: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.part"
    damaged.write_bytes(bundle_bytes()[:-100])
    files = [
        (bundle, ValidationTask(job=job_for())),
        (damaged, ValidationTask(job=job_for())),
        (bundle, ValidationTask(job=job_for(2), sha256="a" * 64)),
    ]
    valid, torn, other = validator.check_all(files)
    assert valid == validator.check(bundle, job_for())
    assert "not a readable zip" in str(torn)
    assert "job.index" in str(other)


def test_a_known_digest_is_not_computed_again(validator: Validator, bundle: Path) -> None:
    rows = validator.check_all(
        [(bundle, ValidationTask(job=job_for(), sha256="a" * 64)), (bundle, ValidationTask(job=job_for()))]
    )
    assert [isinstance(row, InvalidBundle) or row.file_sha256 == "a" * 64 for row in rows] == [True, False]


def test_a_missing_file_does_not_affect_the_other_bundles_of_an_order(
    validator: Validator, bundle: Path, tmp_path: Path
) -> None:
    first, missing, last = validator.check_all(
        [
            (bundle, ValidationTask(job=job_for())),
            (tmp_path / "nothing", ValidationTask(job=job_for())),
            (bundle, ValidationTask(job=job_for())),
        ]
    )
    assert first == last == validator.check(bundle, job_for())
    assert "cannot be read" in str(missing)


def test_the_bundles_of_an_order_whose_child_dies_are_validated_one_by_one(bundle: Path) -> None:
    before = child_processes()
    with Validator() as validator, ThreadPoolExecutor(1) as pool:
        validator.check(bundle, job_for())
        (child,) = child_processes() - before
        os.kill(child, signal.SIGSTOP)
        checking = pool.submit(validator.check_all, [(bundle, ValidationTask(job=job_for()))] * 3)
        time.sleep(0.3)
        os.kill(child, signal.SIGKILL)
        rows = checking.result()
        assert rows == [validator.check(bundle, job_for())] * 3
        assert child not in child_processes()


def test_more_bundles_than_the_limit_of_an_order_are_validated_in_several_orders(
    validator: Validator, bundle: Path
) -> None:
    rows = validator.check_all([(bundle, ValidationTask(job=job_for()))] * (MAX_TASKS + 1))
    assert rows == [validator.check(bundle, job_for())] * (MAX_TASKS + 1)
