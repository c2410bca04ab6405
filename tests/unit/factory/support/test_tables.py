"""Tables on a narrow terminal: readable pieces, each with the identifying columns."""

from __future__ import annotations

import io

from rich.console import Console

from factory.support.terminal import print_table

COLUMNS = ("scene", "split", *(f"a long name {number}" for number in range(7)))
ROWS = [("warehouse_multiple_shelves", "train_id", *range(7)), ("office", "val_id", *range(7, 14))]


def printed(width: int) -> list[str]:
    text = io.StringIO()
    print_table("figures", COLUMNS, ROWS, Console(file=text, width=width, soft_wrap=True))
    return [line.rstrip() for line in text.getvalue().splitlines()]


def test_a_table_that_fits_is_printed_in_one_piece() -> None:
    lines = printed(200)
    assert len(lines) == 4
    assert lines[0] == "figures"
    assert lines[1].split()[:2] == ["scene", "split"]


def test_a_wide_table_is_printed_in_pieces_without_broken_words() -> None:
    lines = printed(80)
    assert max(map(len, lines)) <= 80
    heads = [line for line in lines if line.startswith("scene")]
    assert len(heads) == 4
    assert all(head.split()[1] == "split" for head in heads)
    assert sum("warehouse_multiple_shelves  train_id" in line for line in lines) == len(heads)
    numbers = [int(word) for line in lines if line.startswith("office") for word in line.split()[2:]]
    assert numbers == list(range(7, 14))
    assert lines.count("figures") == 1


def test_a_very_long_cell_is_wrapped_completely() -> None:
    text = io.StringIO()
    print_table("", ("what", "why", "n"), [("x" * 30, "y" * 30, 1)], Console(file=text, width=50, soft_wrap=True))
    assert text.getvalue().count("y") == 30 + len(["why"])
    assert max(map(len, text.getvalue().splitlines())) <= 50
