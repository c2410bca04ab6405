"""Writes the relabelled dataset: links episodes and scenes of the source, and writes the tables with new instructions.

Does not compose instructions. Every file is written atomically, `dataset_meta.json` last.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from coordinator.archive.opening import open_archive
from coordinator.tables.aggregates import aggregate_episodes
from coordinator.tables.card import dataset_card, with_shards
from coordinator.tables.card_configs import splits_at
from coordinator.tables.row_groups import RowGroupWriter
from coordinator.tables.split_tables import write_split_tables
from factory.dataset.reader import Dataset
from factory.export.output import Output
from schemas.dataset.meta import Relabelling
from schemas.language.file import LanguageSpec
from schemas.language.instruction import InstructionKind
from schemas.scene.info import TEXTURES
from schemas.storage.dataset_files import (
    ATTEMPTS_FILE,
    CARD_FILE,
    EPISODES,
    INSTRUCTIONS_FILE,
    META_FILE,
    METADATA_FILE,
    SCENES,
    SHARDS_FILE,
    SPLITS_FOLDER,
)

_GROUP_ROWS = 20_000
"""Number of rows of a row group. To read the rows of one episode, a reader decodes a whole group."""
_NEW_COLUMNS = ("instruction", "template_id")


def assemble(
    dataset: Dataset, instructions: pa.Table, others: Mapping[str, pa.Table], spec: LanguageSpec, output: Output
) -> None:
    """Writes all files of the relabelled dataset.

    Args:
        dataset: source, in a directory.
        instructions: rows of `instructions.parquet`, ordered by episode and number.
        others: additional tables by their file name, ordered by episode.
        spec: content of the language file.
        output: opened output directory.

    Raises:
        WorldError: the disk is full or not available.
    """
    source = Path(str(dataset.root))
    output.begin_finish([dataset.digest])
    for folder in (EPISODES, SCENES, f"{SCENES}/{TEXTURES}", SPLITS_FOLDER):
        for file in sorted((source / folder).glob("*")):
            if file.is_file() and not output.has(f"{folder}/{file.name}"):
                output.link(file, f"{folder}/{file.name}")
    for name in (ATTEMPTS_FILE, SHARDS_FILE):
        if (source / name).is_file():
            output.link(source / name, name)
    for name, table in {INSTRUCTIONS_FILE: instructions, **others}.items():
        with output.replacing(name) as part:
            pq.write_table(table, part, compression="zstd", write_page_checksum=True, row_group_size=_GROUP_ROWS)
    _write_metadata(source, instructions, output)
    _write_description(dataset, instructions, spec, output)
    with open_archive(output.root) as archive:
        write_split_tables(archive)


def _write_metadata(source: Path, instructions: pa.Table, output: Output) -> None:
    """Writes the metadata of the source with the first instruction of each episode."""
    first = instructions.filter(pc.equal(instructions["number"], 1))
    ids = pa.array(first["episode_id"].to_pylist())
    with (
        pq.ParquetFile(source / METADATA_FILE) as file,
        output.replacing(METADATA_FILE) as part,
        part.open("wb") as raw,
        RowGroupWriter(raw, file.schema_arrow) as writer,
    ):
        for number in range(file.num_row_groups):
            rows = file.read_row_group(number)
            places = pc.index_in(rows["episode_id"], value_set=ids)
            for name in _NEW_COLUMNS:
                rows = rows.set_column(rows.schema.get_field_index(name), name, first[name].take(places))
            writer.add(rows)


def _write_description(dataset: Dataset, instructions: pa.Table, spec: LanguageSpec, output: Output) -> None:
    kept = pc.sum(pc.equal(instructions["kind"], InstructionKind.RECORDED)).as_py()
    languages = tuple(sorted(code for code, share in spec.languages.items() if share > 0))
    made = Relabelling(
        spec=spec.model_dump_json(), languages=languages, instructions=len(instructions), recorded=int(kept or 0)
    )
    meta = dataset.meta.model_copy(update={"relabelling": made, "updated_at": datetime.now(UTC)})
    with pq.ParquetFile(output.root / METADATA_FILE) as file:
        aggregates = aggregate_episodes(file.read())
    shards = len(list((output.root / EPISODES).glob("shard_*.zip")))
    output.write_text(CARD_FILE, with_shards(dataset_card(meta, aggregates, splits_at(output.root)), shards))
    output.write_text(META_FILE, meta.model_dump_json(indent=1))
