"""Settings of the zenoh session of a coordinator."""

from __future__ import annotations

import json

from coordinator.protocol.zenoh_config import router_config


def test_only_a_router_that_connects_to_others_waits_for_them_when_it_opens() -> None:
    delays = [
        json.loads(router_config(("tcp/127.0.0.1:0",), 2.0, connect=connect).get_json("scouting/delay"))
        for connect in ((), ("tcp/127.0.0.1:7447",))
    ]
    assert delays[0] == 0
    assert delays[1] != 0
