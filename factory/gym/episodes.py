"""Selects the episodes of an environment: those of dataset splits, or of a spec set. Opens no renderer."""

from __future__ import annotations

from pathlib import Path

from factory.dataset.reader import Dataset
from factory.eval.models.spec import SpecSet, read_specs
from factory.eval.specs.from_dataset import specs_of_dataset
from schemas.errors import UsageError
from schemas.storage.place import Place
from schemas.support.suggest import did_you_mean
from schemas.terms import Split


def specs_for(root: Place, split: str, specs: str | Path | SpecSet | None) -> SpecSet:
    """Returns the episodes of an environment.

    Args:
        root: Location of the dataset.
        split: One or more splits of the dataset, separated by commas.
        specs: File of specs, or a spec set, used instead of `split`.

    Raises:
        UsageError: The split does not exist, or it has no episodes.
        WorldError: The dataset or the file cannot be read.
    """
    if isinstance(specs, SpecSet):
        return specs
    if specs is not None:
        return read_specs(Path(specs))
    names = [name.strip() for name in split.split(",")]
    unknown = [name for name in names if name not in set(Split)]
    if unknown:
        raise UsageError(
            f"unknown split {', '.join(unknown)}; valid splits: {', '.join(Split)}{did_you_mean(unknown[0], Split)}"
        )
    return specs_of_dataset(Dataset(root), [Split(name) for name in names])
