"""Spot checks: which bundles are validated completely, and that the selection depends on a secret."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from coordinator.meters import Meters
from coordinator.protocol.bundles import IncomingBundle
from coordinator.transfer.delivering import SpotCheckedValidation, ValidatedBundle
from coordinator.validation.messages import Scope, ValidationTask, check_each
from schemas.errors import InvalidBundle
from schemas.protocol.messages import Lease
from tests.builders.bundle import job_for


class Recorder:
    """Validator that records the scope of every check and refuses the bundles of given episodes."""

    def __init__(self, invalid: tuple[int, ...] = ()) -> None:
        self.scopes: list[Scope] = []
        self._invalid = invalid

    def check(self, _path: Path, job: Any, _target: Any = None, scope: Scope = Scope.ALL) -> Any:
        self.scopes.append(scope)
        if scope is Scope.ALL and job.index in self._invalid:
            raise InvalidBundle("bundle refused", ["frame 3"])
        return SimpleNamespace(num_steps=1)

    def check_all(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> list[Any]:
        return check_each(self.check, bundles)

    def close(self) -> None:
        pass


def validated(validation: SpotCheckedValidation, pull: IncomingBundle) -> ValidatedBundle | InvalidBundle:
    staged: Any = SimpleNamespace(path=Path(), is_linked=False, sha256="0" * 64)
    pull.part = staged
    (found,) = validation.validate([pull])
    return found


JOB = job_for()


def pull_of(index: int, host: str = "a", *, is_validated: bool = True) -> IncomingBundle:
    lease, target = Lease(job_id=index, fence=1, token="0" * 32), ()
    return IncomingBundle(
        lease, f"{host}.1", f"{index:064x}", 10, JOB.model_copy(update={"index": index}), target, None, is_validated
    )  # type: ignore[arg-type]


def scopes_of(pulls: list[IncomingBundle], share: float | None, secret: bytes = b"s") -> str:
    """Returns a letter for the scope of each validation: `a` for the whole bundle, `c` for the claim only."""
    recorder = Recorder()
    validation = SpotCheckedValidation(recorder, Meters(), share, secret)
    for pull in pulls:
        bundle = validated(validation, pull)
        assert isinstance(bundle, ValidatedBundle)
        assert bundle.is_checked == (recorder.scopes[-1] is Scope.ALL)
    return "".join(scope.value[0] for scope in recorder.scopes)


def test_all_bundles_are_validated_completely_without_spot_checks() -> None:
    assert scopes_of([pull_of(number) for number in range(1, 5)], None) == "aaaa"


def test_the_first_bundle_of_each_host_is_validated_completely() -> None:
    pulls = [pull_of(number, host) for number, host in enumerate("aabba", 1)]
    assert scopes_of(pulls, 0.0) == "acacc"


def test_a_bundle_that_its_worker_has_not_validated_is_validated_completely() -> None:
    assert scopes_of([pull_of(number, is_validated=number != 3) for number in range(1, 5)], 0.0) == "acac"


def test_no_bundle_of_a_host_is_trusted_after_an_invalid_one() -> None:
    pulls = [pull_of(1), pull_of(2), pull_of(3, is_validated=False), pull_of(4), pull_of(5)]
    recorder = Recorder(invalid=(3,))
    validation = SpotCheckedValidation(recorder, Meters(), 0.0)
    for pull in pulls:
        assert isinstance(validated(validation, pull), InvalidBundle) == (pull.job.index == 3)
    assert [scope.value for scope in recorder.scopes] == ["all", "claim", "all", "all", "all"]


def test_the_share_of_spot_checks_is_that_of_the_settings_and_their_selection_depends_on_the_secret() -> None:
    pulls = [pull_of(number) for number in range(1, 2001)]
    one, again, other = (scopes_of(pulls, 0.05, secret) for secret in (b"one", b"one", b"other"))
    assert one == again
    assert 60 <= one.count("a") <= 140  # expected: 100 of 2000, with a standard deviation of 10
    common = sum(x == y == "a" for x, y in zip(one[1:], other[1:], strict=True))
    assert common < one.count("a") / 2
    assert set(scopes_of(pulls[:50], 1.0)) == {"a"}


def test_each_process_draws_a_new_secret() -> None:
    pulls = [pull_of(number) for number in range(1, 200)]
    assert scopes_of(pulls, 0.5, b"") != scopes_of(pulls, 0.5, b"")
