"""Format `paper`: the directory tree of the paper (Table of episode files), one file per frame and sensor; lossless."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import Field

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.export.base import EpisodeFacts, Exporter, Finish, Options
from factory.export.card import CARD_FILE, export_card
from schemas.dataset import PUBLISHED_COLUMNS
from schemas.dataset_files import META_FILE, METADATA_FILE, SPLITS_FOLDER
from schemas.dataset_meta import DatasetMeta
from schemas.encoding.arrays import EPISODE_ARRAYS
from schemas.encoding.ndarray import encode_npy
from schemas.terms import Split

PUBLISHED_SPLITS = {str(Split.TEST_PARAPHRASE_OOD): "test_ood_lang"}
"""The paper's name of a split -> the name in the published repository, where they differ;
docs/design/task.md#splits-and-instructions."""
_OF_THE_BUNDLE = frozenset({"file_sha256", "file_bytes", "file_name"})
_CARD = """
- `episodes/ep_000001/rgb_front/000000.png`: 640 x 640, 8 bit; `depth_front/000000.npy`: float32 metres along the
  optical axis, 0 where nothing was hit; `seg_front/000000.png`: 16-bit instance ids, named in `meta.json`.
- `actions_continuous.npy` (T, 2): v in m/s, w in rad/s; `actions_tokens.npy` (T, 2): 0..6; `poses.npy` (T, 7): x, y, z,
  qw, qx, qy, qz of base_link in the world frame. Frame t is what the robot saw before action t.
- `metadata.parquet`: one row an episode; `data/<split>.parquet`: the same rows by split;
  `dataset_meta.json`: plan, seed, versions.
"""


class PaperOptions(Options):
    """Options of format `paper`."""

    split_names: Literal["paper", "published"] = Field(
        default="paper",
        description="Split names: of the paper, or published (test_ood_lang, as in its repository). Default: paper.",
    )


class PaperExporter(Exporter[PaperOptions, EpisodeFacts]):
    """Exporter of format `paper`: one folder per episode. Copies the bytes of the bundle; depth is decompressed."""

    name = "paper"
    about = "the paper's tree: a PNG, NPY and PNG a frame; lossless and large"
    options = PaperOptions
    facts = EpisodeFacts

    def write_episode(self, episode: Episode, options: PaperOptions, folder: Path) -> EpisodeFacts:
        """Writes `episodes/<id>/`."""
        root = folder / "episodes" / episode.episode_id
        for name in ("rgb_front", "depth_front", "seg_front"):
            (root / name).mkdir(parents=True)
        for t in range(len(episode)):
            for name in (f"rgb_front/{t:06d}.png", f"seg_front/{t:06d}.png"):
                (root / name).write_bytes(episode.stored(name))
            (root / f"depth_front/{t:06d}.npy").write_bytes(encode_npy(episode.depth(t)))
        for spec in EPISODE_ARRAYS:
            (root / f"{spec.name}.npy").write_bytes(episode.stored(f"{spec.name}.npy"))
        (root / "meta.json").write_bytes(_meta(episode.stored("meta.json"), options))
        return EpisodeFacts(frames=len(episode))

    def finish(self, export: Finish[PaperOptions, EpisodeFacts]) -> None:
        """Writes `metadata.parquet`, its rows by split, `dataset_meta.json` and the card."""
        table = _metadata(export.dataset.metadata, [piece.position for piece in export.pieces], export.options)
        with export.out.replacing(METADATA_FILE) as part:
            pq.write_table(table, part, compression="zstd")
        splits = list(dict.fromkeys(table["split"].to_pylist()))
        for split in splits:
            with export.out.replacing(f"{SPLITS_FOLDER}/{split}.parquet") as part:
                pq.write_table(table.filter(pc.equal(table["split"], split)), part, compression="zstd")
        meta = _part_of(export.dataset, [piece.episode_id for piece in export.pieces])
        configs = {
            "default": {split: f"{SPLITS_FOLDER}/{split}.parquet" for split in splits},
            "metadata": {"train": METADATA_FILE},
        }
        card = export_card(meta, len(export.pieces), _CARD, configs)
        export.out.write_text(CARD_FILE, card)
        export.out.write_text(META_FILE, meta.model_dump_json(indent=1))


def published_split(name: str, options: PaperOptions) -> str:
    """Returns the name of a split in the export."""
    return PUBLISHED_SPLITS.get(name, name) if options.split_names == "published" else name


def _meta(text: bytes, options: PaperOptions) -> bytes:
    """Returns `meta.json`: the bytes of the bundle, with the published name of the split."""
    values: dict[str, Any] = json.loads(text)
    split = values["job"]["split"]
    if published_split(split, options) == split:
        return text
    values["job"]["split"] = published_split(split, options)
    return json.dumps(values, indent=1, ensure_ascii=False).encode()


def _metadata(table: pa.Table, positions: Sequence[int], options: PaperOptions) -> pa.Table:
    """Returns the rows of the episodes: the published columns, then the others without those of the bundle file."""
    ours = [name for name in table.column_names if name not in PUBLISHED_COLUMNS and name not in _OF_THE_BUNDLE]
    rows = table.take(positions).select([*PUBLISHED_COLUMNS, *ours])
    splits = pa.array([published_split(name, options) for name in rows["split"].to_pylist()], pa.string())
    return rows.set_column(rows.column_names.index("split"), "split", splits)


def _part_of(dataset: Dataset, names: Sequence[str]) -> DatasetMeta:
    """Returns the metadata of the dataset, restricted to the exported episodes."""
    meta = dataset.meta
    complete = len(names) == meta.planned
    digest = dataset.filter(episode=names).digest if complete else None
    return meta.model_copy(update={"episodes": len(names), "complete": complete, "dataset_digest": digest})
