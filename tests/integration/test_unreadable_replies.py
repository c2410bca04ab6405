"""A worker in a network with a peer that answers coordinator requests with bytes outside the protocol."""

from __future__ import annotations

import zenoh
from structlog.testing import capture_logs

from schemas.protocol.keys import Verb, verb_key
from schemas.protocol.messages import Hello
from tests.builders.fake_coordinator import RUN, FakeCoordinator
from workers.client.link import Link


class InvalidReplier(FakeCoordinator):
    """Answers every request with bytes that are not a message."""

    def _take(self, query: zenoh.Query) -> None:
        *_, host, name = str(query.key_expr).split("/")
        with query:
            query.reply(verb_key(RUN, host, Verb(name)), b"\x00\xff rubbish")


def test_unreadable_replies_are_ignored_and_do_not_fill_the_log() -> None:
    babbler = InvalidReplier(())
    babbler.open()
    link = Link((babbler.endpoint,), "host")
    try:
        assert link.open()
        with capture_logs() as lines:
            for _ in range(200):
                assert link.send_hello(Hello(sid="host.1", host="host", slots=1, version="1")) == ()
    finally:
        link.close()
        babbler.close()
    assert 1 <= [line["event"] for line in lines].count("reply_invalid") < 20
