"""Packs the episodes of a states dataset into shards. Does not change the ledger.

During a run, a range of numbers is packed when no job of the range can change.

Design: docs/design/data.md#shards-of-packed-episodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import structlog
from sqlalchemy import func, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.ledger.states import OPEN_STATES
from coordinator.ledger.tables import BUILD, episodes, jobs
from coordinator.tables.card import with_shards
from schemas.plan import Plan
from schemas.storage.dataset_files import CARD_FILE
from schemas.storage.shards import MAX_SHARD_EPISODES, range_of, range_of_shard
from schemas.terms import Recording

log = structlog.get_logger(__name__)

Range = tuple[int, int]


def pack_settled(
    archive: Archive, connection: Connection, plan: Plan, is_over: bool, size: int = MAX_SHARD_EPISODES
) -> int:
    """Packs the settled ranges of a run: all jobs of the range are archived, failed or cancelled.

    Episodes that are archived after their range was packed remain files until the run is over. Datasets of one range,
    and datasets of frames, are not packed.

    Args:
        archive: archive of the run, held exclusively.
        connection: connection to the ledger, for reading.
        plan: plan of the run.
        is_over: whether no job of the run can change.
        size: number of episode numbers of a range.

    Returns:
        The number of packed episodes.

    Raises:
        WorldError: the disk is full or unavailable; no episode is lost.
    """
    if plan.record is not Recording.STATES or plan.episodes <= size:
        return 0
    packed = set() if is_over else {range_of_shard(name) for name in archive.shards()}
    waiting = {range_of(index, size) for index in archive.unpacked()}
    settled = [span for span in sorted(waiting - packed) if not _is_open(connection, span)]
    return pack_ranges(archive, ((span, _owned(connection, span)) for span in settled))


def pack_all(archive: Archive, owned: Mapping[int, str]) -> int:
    """Packs all episodes of a dataset that are files, and states the number of shards in the card.

    Args:
        archive: archive of the dataset, held exclusively.
        owned: SHA-256 of each episode by number, from the tables of the dataset.

    Returns:
        The number of packed episodes.

    Raises:
        WorldError: the disk is full or unavailable; no episode is lost.
    """
    spans = sorted({range_of(index) for index in archive.unpacked()})
    of_spans = ({index: owned[index] for index in range(first, last + 1) if index in owned} for first, last in spans)
    count = pack_ranges(archive, zip(spans, of_spans, strict=True))
    _state_in_card(archive)
    return count


def _state_in_card(archive: Archive) -> None:
    try:
        card = (archive.root / CARD_FILE).read_text(encoding="utf-8")
    except FileNotFoundError:
        return  # when the card is written, it will state the number of shards
    stated = with_shards(card, len(archive.shards()))
    if stated != card:
        with archive.replacing(CARD_FILE) as part:
            part.write_text(stated, encoding="utf-8")


def pack_ranges(archive: Archive, ranges: Iterable[tuple[Range, Mapping[int, str]]]) -> int:
    """Packs ranges of episodes and writes the index; returns the number of packed episodes.

    Args:
        archive: archive of the dataset, held exclusively.
        ranges: ranges of numbers, each with the SHA-256 of its episodes by number.

    Raises:
        WorldError: the disk is full or unavailable; no episode is lost.
    """
    count = sum(archive.pack(owned, *span) for span, owned in ranges)
    if count:
        archive.write_shard_index()
        log.info("episodes_packed", episodes=count, shards=len(archive.shards()))
    return count


def _is_open(connection: Connection, span: Range) -> bool:
    query = select(jobs.c.id).where(jobs.c.idx.between(*span), jobs.c.state.in_(OPEN_STATES)).limit(1)
    if connection.execute(query).first() is not None:
        return True
    building = select(jobs.c.id).where(jobs.c.tier == BUILD, jobs.c.state.in_(OPEN_STATES)).limit(1)
    if connection.execute(building).first() is None:
        return False
    present = select(func.count(jobs.c.idx.distinct())).where(jobs.c.idx.between(*span))
    # the episodes of unbuilt layouts are not in the ledger
    return connection.execute(present).scalar_one() < span[1] - span[0] + 1


def _owned(connection: Connection, span: Range) -> dict[int, str]:
    query = select(episodes.c.idx, episodes.c.sha256).where(episodes.c.idx.between(*span))
    return {row.idx: row.sha256 for row in connection.execute(query)}
