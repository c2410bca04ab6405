"""The queue that next serves the owner that has consumed the least time."""

from __future__ import annotations

import threading

from coordinator.transfer.fair_queue import FairQueue


def serve(queue: FairQueue[str], seconds: float) -> str:
    taken = queue.take()
    assert taken is not None
    owner, (item,) = taken
    queue.give(owner, seconds)
    return item


def test_the_least_served_owner_is_next() -> None:
    queue: FairQueue[str] = FairQueue()
    for item in ("a1", "a2", "a3"):
        queue.put("a", item)
    assert serve(queue, 5) == "a1"
    queue.put("b", "b1")
    queue.put("b", "b2")
    assert serve(queue, 5) == "a2"  # b joined only now, and gets no credit for the time before
    assert [serve(queue, 0.1) for _ in range(3)] == ["b1", "b2", "a3"]


def test_items_of_one_owner_stay_in_order_and_an_unfinished_item_is_first() -> None:
    queue: FairQueue[str] = FairQueue()
    queue.put("a", "a1")
    queue.put("a", "a2")
    owner, turn = queue.take() or ("", [])
    queue.give(owner, 1, turn)
    assert [serve(queue, 1), serve(queue, 1)] == ["a1", "a2"]


def test_an_owner_has_a_second_active_item_only_while_no_other_owner_waits() -> None:
    queue: FairQueue[str] = FairQueue()
    for item in ("a1", "a2", "a3"):
        queue.put("a", item)
    queue.put("b", "b1")
    taken = [queue.take() for _ in range(3)]
    assert [turn for _, turn in filter(None, taken)] == [["a1"], ["b1"], ["a2"]]
    assert queue.has_others("b")
    assert not queue.has_others("a")
    assert queue.sizes() == {"a": 3, "b": 1}


def test_consecutive_small_items_of_an_owner_are_served_in_one_turn() -> None:
    queue: FairQueue[str] = FairQueue(lambda turn, item: len(turn) < 3 and item.startswith("small"))
    for item in ("small1", "small2", "large", "small3", "small4", "small5", "small6"):
        queue.put("a", item)
    queue.put("b", "small7")
    turns = []
    for _ in range(4):
        owner, turn = queue.take() or ("", [])
        turns.append((owner, turn))
        queue.give(owner, 1)
    assert turns == [
        ("a", ["small1", "small2"]),
        ("b", ["small7"]),
        ("a", ["large", "small3", "small4"]),
        ("a", ["small5", "small6"]),
    ]


def test_the_unfinished_items_of_a_turn_keep_their_order() -> None:
    queue: FairQueue[str] = FairQueue(lambda turn, _item: len(turn) < 2)
    for item in ("a1", "a2", "a3"):
        queue.put("a", item)
    owner, turn = queue.take() or ("", [])
    queue.give(owner, 1, turn)
    assert [items for _, items in (queue.take() or ("", []), queue.take() or ("", []))] == [["a1", "a2"], ["a3"]]


def test_a_closed_queue_returns_its_items_and_wakes_blocked_threads() -> None:
    queue: FairQueue[str] = FairQueue()
    ends: list[object] = []
    waiting = threading.Thread(target=lambda: ends.append(queue.take()))
    waiting.start()
    assert queue.close() == []
    waiting.join(10)
    assert ends == [None]
    queue.put("a", "a1")
    assert queue.take() is None


def test_an_owner_that_is_done_is_forgotten() -> None:
    queue: FairQueue[str] = FairQueue()
    for number in range(100):
        queue.put(f"owner-{number}", "item")
        serve(queue, 1)
    assert queue.sizes() == {}
