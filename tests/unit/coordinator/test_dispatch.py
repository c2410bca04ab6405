"""Assignment of bundles to pullers, with gateways that claim too many routers or those of others."""

from __future__ import annotations

from coordinator.protocol.dispatch import Dispatch
from coordinator.protocol.pulls import Pull
from schemas.protocol.messages import Lease
from tests.builders.bundle import job_for
from tests.builders.ledger import room_catalog

TARGET = room_catalog()["room"].info.targets[0]


class Desk:
    """A dispatch with a test clock."""

    def __init__(self) -> None:
        self.now = 0.0
        self.here: list[int] = []
        self.dispatch = Dispatch(lambda pull: self.here.append(pull.job.index), lambda: self.now)

    def offer(self, index: int, via: str) -> None:
        lease = Lease(job_id=index, fence=1, token="0" * 32)
        self.dispatch.offer(Pull(lease, f"host-{index}.1", "0" * 64, 7, job_for(index), TARGET, via))

    def take(self, gateway: str, router: str) -> list[int]:
        return [pull.job.index for pull in self.dispatch.take(gateway, router, 64)]


def test_a_gateway_cannot_take_the_router_of_an_active_gateway() -> None:
    desk = Desk()
    assert desk.take("honest", "a") == []
    for _ in range(100):
        assert desk.take("hostile", "a") == []
        desk.now += 0.2
        desk.offer(1, "a")
        assert desk.take("hostile", "a") == []
        assert desk.take("honest", "a") == [1]


def test_a_router_is_reassigned_when_its_gateway_is_silent() -> None:
    desk = Desk()
    desk.take("former", "a")
    desk.now += 11.0
    desk.take("new", "a")
    desk.offer(1, "a")
    assert desk.take("former", "a") == []
    assert desk.take("new", "a") == [1]


def test_the_number_of_gateways_is_bounded_and_an_honest_one_is_served() -> None:
    desk = Desk()
    for number in range(3000):
        desk.take(f"hostile-{number}", f"{number:x}")
        if number % 500 == 0:
            desk.take("honest", "ffffff")
    desk.offer(1, "ffffff")
    assert desk.take("honest", "ffffff") == [1]
    desk.offer(2, "0")  # of the first of them
    assert desk.here == [2]


def test_a_gateway_that_names_many_routers_keeps_the_last_one() -> None:
    desk = Desk()
    for number in range(100):
        desk.take("hostile", f"{number:x}")
    desk.offer(1, "0")
    assert desk.here == [1]
    desk.offer(2, f"{99:x}")
    assert desk.take("hostile", f"{99:x}") == [2]
