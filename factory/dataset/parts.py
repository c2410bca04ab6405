"""What a dataset directory consists of, by name."""

from __future__ import annotations

from pathlib import Path

from coordinator.archive.contract import EPISODES, LEDGER_FILE, QUARANTINE, SCENES
from coordinator.tables.card import CARD_FILE
from coordinator.tables.card_configs import SPLITS_FOLDER
from coordinator.tables.write import ATTEMPTS_FILE, METADATA_FILE
from schemas.dataset_meta import META_FILE

__all__ = ["is_dataset", "is_part"]

_PARTS = frozenset({EPISODES, SCENES, SPLITS_FOLDER, META_FILE, METADATA_FILE, ATTEMPTS_FILE, CARD_FILE, QUARANTINE})


def is_part(name: str) -> bool:
    """Whether an entry of a dataset's directory belongs to it; hidden ones and the ledger's own files do."""
    return name in _PARTS or name.startswith((".", "ledger."))


def is_dataset(folder: Path) -> bool:
    """Whether a directory is that of a run, finished or not."""
    return (folder / LEDGER_FILE).is_file() or (folder / META_FILE).is_file()
