"""Objects that are not targets are counted, listed up to a limit, and grouped by reason."""

from __future__ import annotations

from factory.scenes.inspection import describe_counts, describe_rest, list_other_things
from tests.builders.scene import box_room


def test_counts_are_printed_in_the_order_of_names() -> None:
    assert describe_counts({"shelf": 6, "bin": 1}) == "1 bin, 6 shelf"
    assert describe_counts({}) == "none"


def test_a_long_list_of_objects_is_shortened() -> None:
    others = [{"prim_path": f"/W/{n:02d}", "category": None} for n in range(20)]
    head, line = describe_rest([*others], 30)
    assert head == "not targets: 20 of 30 instances"
    assert line.startswith("  20 without a category: /W/00, ")
    assert line.endswith("/W/11, and 8 more")


def test_unreachable_objects_of_a_category_are_reported_separately() -> None:
    _, line = describe_rest([{"prim_path": "/W/bin", "category": "bin"}], 3)
    assert line == "  1 with a category, but unreachable or excluded: /W/bin (bin)"


def test_targets_and_other_objects_are_all_instances() -> None:
    info = box_room().info
    others = {thing["prim_path"] for thing in list_other_things(info)}
    assert others.isdisjoint(target.prim_path for target in info.targets)
    assert len(others) + len(info.targets) == len(info.instances)
