"""Policies behind a websocket: protocol, servers that start late, server errors, lost connections, foreign servers."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.server import ServerConnection

from factory.eval.driving.action import read_actions
from factory.eval.driving.policy import EpisodeInfo, PolicyFailure, PolicyFault, PolicyInput, ServerUnreachable
from factory.eval.models.messages import PolicyLimits
from factory.eval.policies.made_from import GREETING, greeting_now
from factory.eval.policies.registry import make_policy
from factory.eval.policies.remote import RemotePolicy, WireError, pack, unpack
from schemas.errors import UsageError
from tests.builders.policy_server import policy_server

EXAMPLES = Path(__file__).parent.parent.parent / "docs" / "evaluation"
INFO = EpisodeInfo("ep_000001", 7, 60, 1000, (0.0, 1.0), (-1.5, 1.5), 90.0)
VIEW = PolicyInput(
    rgb=np.arange(4 * 4 * 3, dtype=np.uint8).reshape(4, 4, 3),
    depth=np.full((4, 4), 1.5, np.float32),
    state=np.array((0.5, 0.25, 0.1, 0.75, -0.5), np.float32),
    instruction="Go to the chair.",
    step=0,
)
QUICK = PolicyLimits(act_timeout_s=0.5, load_timeout_s=2.0, reconnect_s=0.3)


def begin(address: str, limits: PolicyLimits = QUICK) -> RemotePolicy:
    policy = make_policy(address, limits)
    assert isinstance(policy, RemotePolicy)
    policy.reset("Go to the chair.", INFO)
    return policy


def test_a_server_receives_the_observation_and_its_answer_is_returned() -> None:
    seen: list[dict[str, Any]] = []

    def answer(connection: ServerConnection, observation: dict[str, Any]) -> None:
        seen.append(observation)
        connection.send(pack({"actions": np.array([[0.5, 0.1], [0.4, 0.0]], np.float32)}))

    with policy_server(answer) as address:
        policy = begin(address)
        actions = policy.act(VIEW)["actions"]
        policy.close()
    np.testing.assert_allclose(actions, [[0.5, 0.1], [0.4, 0.0]])
    np.testing.assert_array_equal(seen[0]["state"], VIEW["state"])
    assert seen[0]["state"].dtype == np.float32
    assert {key: seen[0][key] for key in ("prompt", "step", "episode", "seed")} == {
        "prompt": "Go to the chair.",
        "step": 0,
        "episode": "ep_000001",
        "seed": 7,
    }
    np.testing.assert_array_equal(seen[0]["rgb"], VIEW["rgb"])
    np.testing.assert_array_equal(seen[0]["depth"], VIEW["depth"])
    assert policy.metadata == {"name": "test"}


def test_an_error_of_the_server_is_a_policy_failure_with_its_message() -> None:
    with policy_server(lambda connection, _: connection.send("Traceback ...\nValueError: no key rgb")) as address:
        policy = begin(address)
        with pytest.raises(PolicyFailure, match="ValueError: no key rgb") as caught:
            policy.act(VIEW)
        policy.close()
    assert caught.value.fault is PolicyFault.RAISED


def test_malformed_bytes_are_an_invalid_answer() -> None:
    with policy_server(lambda connection, _: connection.send(b"\xc1")) as address:
        policy = begin(address)
        with pytest.raises(PolicyFailure, match="not a valid msgpack message") as caught:
            policy.act(VIEW)
        policy.close()
    assert caught.value.fault is PolicyFault.INVALID


def test_a_late_answer_is_a_hang_and_is_never_used_for_the_next_request() -> None:
    calls: list[int] = []

    def answer(connection: ServerConnection, observation: dict[str, Any]) -> None:
        calls.append(observation["step"])
        if len(calls) == 2:
            time.sleep(0.8)
        connection.send(pack({"actions": np.array([0.1 * len(calls), 0.0])}))

    with policy_server(answer) as address:
        policy = begin(address)
        policy.act(VIEW)
        with pytest.raises(PolicyFailure, match=r"within 0.5 s") as caught:
            policy.act(VIEW)
        policy.reset("Go to the chair.", INFO)
        assert policy.act(VIEW)["actions"][0] == pytest.approx(0.3)
        policy.close()
    assert caught.value.fault is PolicyFault.HUNG


def test_a_closed_connection_is_reopened_for_the_next_episode() -> None:
    calls: list[int] = []

    def answer(connection: ServerConnection, observation: dict[str, Any]) -> None:
        calls.append(1)
        if len(calls) == 1:
            connection.close()
        else:
            connection.send(pack({"actions": np.zeros(2)}))

    with policy_server(answer) as address:
        policy = begin(address)
        with pytest.raises(PolicyFailure, match="closed the connection") as caught:
            policy.act(VIEW)
        policy.reset("Go to the chair.", INFO)
        assert policy.act(VIEW)["actions"].tolist() == [0.0, 0.0]
        policy.close()
    assert caught.value.fault is PolicyFault.LOST


def test_a_restarted_server_gets_the_long_timeout_for_its_first_answer() -> None:
    calls: list[int] = []

    def answer(connection: ServerConnection, observation: dict[str, Any]) -> None:
        calls.append(1)
        if len(calls) == 2:
            connection.close()
            return
        if len(calls) == 3:
            time.sleep(0.3)
        connection.send(pack({"actions": np.full(2, 0.1 * len(calls))}))

    with policy_server(answer) as address:
        policy = begin(address, PolicyLimits(act_timeout_s=0.1, load_timeout_s=120.0, reconnect_s=60.0))
        policy.act(VIEW)
        with pytest.raises(PolicyFailure):
            policy.act(VIEW)
        policy.reset("Go to the chair.", INFO)
        assert policy.act(VIEW)["actions"][0] == pytest.approx(0.3)
        policy.close()


def test_an_unreachable_server_is_not_a_policy_failure() -> None:
    with policy_server(lambda connection, _: connection.close()) as address:
        policy = begin(address)
        with pytest.raises(PolicyFailure):
            policy.act(VIEW)
    with pytest.raises(ServerUnreachable, match=r"no policy server responded at ws://127.0.0.1:\d+ for 0.3 s"):
        policy.reset("Go to the chair.", INFO)
    with pytest.raises(ServerUnreachable):
        begin(address)


def test_an_endpoint_without_a_policy_server_is_reported_immediately() -> None:
    with (
        policy_server(lambda _c, _o: None, greeting="hello") as address,
        pytest.raises(UsageError, match="not an openpi policy server"),
    ):
        begin(address)
    with pytest.raises(UsageError, match="write ws://HOST:PORT"):
        begin("ws:nonsense")


@pytest.mark.parametrize("value", [np.float32(0.25), np.arange(6, dtype=np.int16).reshape(2, 3), {"a": [1, "b", None]}])
def test_packed_values_are_unpacked_unchanged(value: Any) -> None:
    found = unpack(pack(value))
    np.testing.assert_equal(found, value)
    assert getattr(found, "dtype", None) == getattr(value, "dtype", None)


def test_arrays_are_packed_as_openpi_packs_them() -> None:
    import msgpack

    raw = msgpack.unpackb(pack(np.array([1.0, 2.0], "<f4")))
    assert raw == {b"__ndarray__": True, b"data": b"\x00\x00\x80?\x00\x00\x00@", b"dtype": "<f4", b"shape": [2]}


@pytest.mark.parametrize(
    "fake",
    [
        {b"__ndarray__": True, b"data": b"1234", b"dtype": "<f4", b"shape": [1 << 40]},
        {b"__ndarray__": True, b"data": b"1234", b"dtype": "|O", b"shape": [1]},
        {b"__ndarray__": True, b"data": b"1234", b"dtype": "rubbish", b"shape": [1]},
        {b"__ndarray__": True, b"data": b"1234", b"dtype": "<f4", b"shape": [-1]},
        {b"__npgeneric__": True, b"data": b"1234", b"dtype": "|O8"},
    ],
)
def test_an_array_with_inconsistent_metadata_is_refused_before_allocation(fake: dict[bytes, Any]) -> None:
    import msgpack

    with pytest.raises(WireError, match="contains an array"):
        unpack(msgpack.packb(fake))
    with pytest.raises(WireError):
        pack(np.array([object()]))


def test_the_example_server_drives_forward_on_free_floor_and_turns_before_a_wall() -> None:
    command = [sys.executable, str(EXAMPLES / "policy_server.py"), "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        policy = begin(process.stdout.readline().split()[-1], PolicyLimits())
        found = [read_actions(policy.act(look(depth_m)), "continuous", 1.0, 1.5) for depth_m in (3.0, 0.4)]
        policy.close()
    finally:
        process.kill()
        process.communicate()
    assert [len(chunk.twists) for chunk in found] == [6, 6]
    assert [chunk.twists[0].v_mps > 0 for chunk in found] == [True, False]


def test_the_example_class_answers_with_actions_within_range(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)  # a policy in the working directory need not be installed
    monkeypatch.setattr(sys, "path", list(sys.path))
    policy = make_policy("my_policy:TowardsOpenFloor", QUICK)
    policy.reset("Go to the chair.", INFO)
    found = [read_actions(policy.act(look(depth_m)), "continuous", 1.0, 1.5) for depth_m in (3.0, 0.4)]
    assert [chunk.twists[0].v_mps > 0 for chunk in found] == [True, False]
    assert [chunk.beyond for chunk in found] == [0, 0]


def look(depth_m: float) -> PolicyInput:
    """Returns the input of a policy that faces a wall at a distance."""
    rgb, depth = np.zeros((640, 640, 3), np.uint8), np.full((640, 640), depth_m, np.float32)
    return PolicyInput(rgb=rgb, depth=depth, instruction="Go to the chair.", step=0)


def test_the_greeting_of_a_server_is_read_without_an_observation_and_differs_with_its_version() -> None:
    def answer(connection: ServerConnection, observation: dict[str, Any]) -> None:
        raise AssertionError("no observation is sent for the greeting")

    found = []
    for version in (1, 1, 2):
        with policy_server(answer, pack({"name": "test", "version": version})) as address:
            found.append(greeting_now(address))
    assert found[0] == found[1] != found[2]
    assert set(found[0]) == {GREETING}
    assert greeting_now("ws://127.0.0.1:9") == {}
    with policy_server(answer, greeting=None) as address:
        assert greeting_now(address) == {}
