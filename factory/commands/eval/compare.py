"""`factory eval compare`: paired comparison of two policies on the same episodes."""

from __future__ import annotations

from pathlib import Path

from factory.commands.common.output import print_result
from factory.commands.eval.tables import print_comparison
from factory.eval.models.result import Variant
from factory.eval.results.compare import compare
from factory.eval.results.store import read_policy_folder


def execute(first: Path, second: Path, variant: str, as_json: bool) -> int:
    """Executes `factory eval compare`."""
    (_, ones), (_, others) = read_policy_folder(first), read_policy_folder(second)
    found = compare(ones, others, Variant(variant))
    print_result(found, as_json, print_comparison)
    return 0
