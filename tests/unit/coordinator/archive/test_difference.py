"""Comparison of the files of an archive with the records of the ledger."""

from __future__ import annotations

from coordinator.archive.difference import GONE, ListedFile, RecordedFile, describe_difference, diff_archive


def test_files_that_match_their_records_have_no_difference() -> None:
    difference = diff_archive({1: ListedFile(5), 2: ListedFile(6, "b")}, {1: RecordedFile(5), 2: RecordedFile(6, "b")})
    assert difference.same == (1, 2)
    assert (difference.missing, difference.strays, difference.elsewhere) == ((), (), ())


def test_record_without_file_is_missing_and_file_without_record_unknown() -> None:
    difference = diff_archive({3: ListedFile(5), 2: ListedFile(5)}, {9: RecordedFile(5), 7: RecordedFile(5)})
    assert (difference.missing, difference.unknown, difference.strays) == ((7, 9), (2, 3), (2, 3))


def test_a_change_is_described_with_both_values() -> None:
    listed = {1: ListedFile(4), 2: ListedFile(5, "x"), 3: ListedFile(5, fault="cannot be read: I/O error")}
    difference = diff_archive(listed, dict.fromkeys((1, 2, 3), RecordedFile(5, "a")))
    assert difference.changed == {
        1: "4 bytes; in the ledger 5",
        2: "SHA-256 x; in the ledger a",
        3: "cannot be read: I/O error",
    }
    assert difference.same == ()


def test_digest_that_was_not_computed_is_not_compared() -> None:
    assert diff_archive({1: ListedFile(5)}, {1: RecordedFile(5, "a")}).same == (1,)


def test_an_episode_at_a_gateway_is_not_missing_and_a_local_copy_of_it_is_reported() -> None:
    kept = {1: RecordedFile(5, gateway="g"), 2: RecordedFile(5, gateway="g"), 3: RecordedFile(5, gateway="g")}
    difference = diff_archive({2: ListedFile(5), 3: ListedFile(4)}, kept)
    assert (difference.missing, difference.elsewhere, difference.strays) == ((), (2,), (3,))


def test_missing_file_differs_from_its_record() -> None:
    assert describe_difference(None, RecordedFile(5)) == GONE
    assert describe_difference(ListedFile(5), RecordedFile(5)) == ""
