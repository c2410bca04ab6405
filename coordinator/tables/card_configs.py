"""Generates the `configs` section of a dataset card, which maps files to configurations and splits.

`datasets` and the Hub's viewer read the section. Every listed split must have files, so splits without files are
omitted. The module reads file names only.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import yaml

from schemas.storage.dataset_files import SPLITS_FOLDER
from schemas.storage.place import Place, children
from schemas.terms import Split

_BEGIN, _END = "configs:", "---\n"

Configs = Mapping[str, Mapping[str, str]]
"""Mapping of configuration name to split to path or pattern of its files; the first configuration is the default."""


def split_configs(splits: Collection[str], episodes: int, failed_attempts: int) -> Configs:
    """Returns the configurations of a dataset that have rows; `datasets` cannot load a configuration without rows.

    Args:
        splits: splits with split tables; if empty, the default is `metadata.parquet` with all rows as `train`.
        episodes: number of rows of `metadata.parquet`.
        failed_attempts: number of rows of `attempts.parquet`.
    """
    everything = {"train": "metadata.parquet"}
    files = {split: f"{SPLITS_FOLDER}/{split}-*.parquet" for split in splits} or everything
    configs = {"default": files, "metadata": everything} if episodes else {}
    return configs | ({"attempts": {"train": "attempts.parquet"}} if failed_attempts else {})


def splits_at(root: Place) -> tuple[str, ...]:
    """Returns the splits with split tables in a dataset, in the order of `Split`."""
    names = [place.name for place in children(root / SPLITS_FOLDER)]
    return tuple(str(split) for split in Split if any(name.startswith(f"{split}-") for name in names))


def configs_to_yaml(configs: Configs) -> str:
    """Returns the configurations as YAML for the card's front matter."""
    entries: list[dict[str, Any]] = []
    for name, files in configs.items():
        first = {} if entries else {"default": True}
        data_files = [{"split": split, "path": path} for split, path in files.items()]
        entries.append({"config_name": name, **first, "data_files": data_files})
    return yaml.safe_dump({"configs": entries}, sort_keys=False)


def with_configs(card: str, configs: Configs) -> str:
    """Returns a card with its configurations replaced; a card without configurations is returned unchanged."""
    before, begin, rest = card.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    return before + configs_to_yaml(configs) + end + after if begin and end else card


def names_split_tables(card: str) -> bool:
    """Returns whether a card's configurations name split tables."""
    configs = card.partition(_BEGIN)[2].partition(_END)[0]
    return f"path: {SPLITS_FOLDER}/" in configs
