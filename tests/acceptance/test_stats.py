"""`factory stats` from the command line."""

from __future__ import annotations


def test_stats_of_a_run_count_its_episodes_and_attempts(command, reference):
    found = command.json("stats", reference)
    assert (found["episodes"], found["complete"], found["remarks"]) == (5, True, [])
    assert sum(cell["archived"] for cell in found["cells"]) == 5
    (everything,) = [row for row in found["attempts"] if row["group"] == "all"]
    assert everything["attempts"] >= 5
    (error,) = [row for row in found["navigation_error"] if row["group"] == "all"]
    assert error["within_radius"]["share"] == 1.0
