"""`factory eval compare`: paired comparison of two policies on the same episodes."""

from __future__ import annotations

from pathlib import Path

import click

from factory.cli.common.output import json_option, print_result
from factory.cli.eval.tables import print_comparison
from factory.eval.models.result import Variant
from factory.eval.results.compare import compare
from factory.eval.results.store import read_policy_folder

_RESULTS = click.Path(path_type=Path)


@click.command("compare")
@click.argument("first", metavar="A", type=_RESULTS)
@click.argument("second", metavar="B", type=_RESULTS)
@click.option(
    "--variant",
    type=click.Choice([str(v) for v in Variant]),
    default="original",
    show_default=True,
    help="Instruction variant to compare.",
)
@json_option
def command(first: Path, second: Path, variant: str, as_json: bool) -> int:
    """Compare two policies on the episodes that both have run.

    A and B are folders OUT/policies/NAME of `factory eval -o OUT`, e.g. OUT/policies/bc:bc, or OUT if it contains one
    policy.
    """
    (_, ones), (_, others) = read_policy_folder(first), read_policy_folder(second)
    found = compare(ones, others, Variant(variant))
    print_result(found, as_json, print_comparison)
    return 0
