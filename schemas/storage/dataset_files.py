"""Names of the files and folders of a dataset directory. Opens no file."""

from __future__ import annotations

from pathlib import Path

EPISODES, SCENES, STAGING, QUARANTINE = "episodes", "scenes", ".staging", "quarantine"
LEDGER_FILE = "ledger.db"
LEDGER_PLACE_FILE = "ledger.json"
"""File beside the dataset that names the ledger, if it is not `ledger.db` there."""
METADATA_FILE, ATTEMPTS_FILE = "metadata.parquet", "attempts.parquet"
SHARDS_FILE = "shards.parquet"
INSTRUCTIONS_FILE, RELABEL_FILE = "instructions.parquet", "relabel.json"
STEPS_FILE, QUESTIONS_FILE = "steps.parquet", "questions.parquet"
META_FILE = "dataset_meta.json"
CARD_FILE = "README.md"
RUN_SHARD_FILE = "run_shard.json"
MARKS_FILE = "marks.json"
SPLITS_FOLDER = "data"
EXTENSION, FORMER_LEDGERS, SOURCES_FILE = ".extension", ".ledgers", ".sources.json"
_TABLES = {METADATA_FILE, ATTEMPTS_FILE, SHARDS_FILE, INSTRUCTIONS_FILE, STEPS_FILE, QUESTIONS_FILE}
_FOLDERS = {EPISODES, SCENES, SPLITS_FOLDER, QUARANTINE}
_PARTS = frozenset({*_FOLDERS, META_FILE, CARD_FILE, MARKS_FILE, RELABEL_FILE, RUN_SHARD_FILE, *_TABLES})


def is_part(name: str) -> bool:
    """Returns whether a directory entry belongs to the dataset; true for hidden files and the files of the ledger."""
    return name in _PARTS or name.startswith(".") or is_ledger_file(name)


def is_ledger_file(name: str) -> bool:
    """Returns whether a directory entry is a file of the ledger."""
    return name.startswith("ledger.")


def is_dataset(folder: Path) -> bool:
    """Returns whether a directory contains the dataset of a run, finished or unfinished."""
    return (folder / LEDGER_FILE).is_file() or (folder / META_FILE).is_file()


def is_submitted_run(folder: Path) -> bool:
    """Returns whether a directory is the folder of a run of `factory submit`; the dataset is a directory in it."""
    return (folder / "slurm" / "plan.toml").is_file()
