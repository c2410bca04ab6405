"""Assignment of bundles to pullers, with gateways that claim too many routers or the routers of other gateways."""

from __future__ import annotations

from coordinator.protocol.bundles import IncomingBundle
from coordinator.protocol.dispatch import Dispatch
from schemas.protocol.messages import Lease
from tests.builders.bundle import job_for
from tests.builders.ledger import room_catalog

TARGET = room_catalog()["room"].info.targets[0]


class TimedDispatch:
    """A dispatch with a test clock."""

    def __init__(self) -> None:
        self.now = 0.0
        self.here: list[int] = []
        self.dispatch = Dispatch(lambda pull: self.here.append(pull.job.index), lambda: self.now)

    def offer(self, index: int, via: str) -> None:
        lease = Lease(job_id=index, fence=1, token="0" * 32)
        self.dispatch.offer(IncomingBundle(lease, f"host-{index}.1", "0" * 64, 7, job_for(index), TARGET, via))

    def take(self, gateway: str, router: str) -> list[int]:
        return [pull.job.index for pull in self.dispatch.take(gateway, router, 64)]


def test_a_gateway_cannot_take_the_router_of_an_active_gateway() -> None:
    timed_dispatch = TimedDispatch()
    assert timed_dispatch.take("honest", "a") == []
    for _ in range(100):
        assert timed_dispatch.take("hostile", "a") == []
        timed_dispatch.now += 0.2
        timed_dispatch.offer(1, "a")
        assert timed_dispatch.take("hostile", "a") == []
        assert timed_dispatch.take("honest", "a") == [1]


def test_a_router_is_reassigned_when_its_gateway_is_silent() -> None:
    timed_dispatch = TimedDispatch()
    timed_dispatch.take("former", "a")
    timed_dispatch.now += 11.0
    timed_dispatch.take("new", "a")
    timed_dispatch.offer(1, "a")
    assert timed_dispatch.take("former", "a") == []
    assert timed_dispatch.take("new", "a") == [1]


def test_the_number_of_gateways_is_bounded_and_an_honest_gateway_is_served() -> None:
    timed_dispatch = TimedDispatch()
    for number in range(3000):
        timed_dispatch.take(f"hostile-{number}", f"{number:x}")
        if number % 500 == 0:
            timed_dispatch.take("honest", "ffffff")
    timed_dispatch.offer(1, "ffffff")
    assert timed_dispatch.take("honest", "ffffff") == [1]
    timed_dispatch.offer(2, "0")  # this router was assigned to the first hostile gateway
    assert timed_dispatch.here == [2]


def test_a_gateway_that_names_many_routers_is_assigned_only_the_last_router() -> None:
    timed_dispatch = TimedDispatch()
    for number in range(100):
        timed_dispatch.take("hostile", f"{number:x}")
    timed_dispatch.offer(1, "0")
    assert timed_dispatch.here == [1]
    timed_dispatch.offer(2, f"{99:x}")
    assert timed_dispatch.take("hostile", f"{99:x}") == [2]
