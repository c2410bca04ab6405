"""Options that several verbs share, each defined once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

import click
from click.shell_completion import CompletionItem

from coordinator.plan.builtin import BUILTIN_PLANS
from coordinator.plan.cells import empty_splits
from coordinator.plan.file import shrink
from factory.cli.places import DIRECTORY, PLACE, SITE
from schemas.plan import Plan
from schemas.terms import BUILTIN_CATEGORIES, ExpertName, RendererKind

__all__ = [
    "compare_option",
    "dataset_argument",
    "ledger_option",
    "out_option",
    "place_argument",
    "plan_argument",
    "renderer_option",
    "shrink_options",
    "shrunk_plan",
    "site_argument",
    "tls_option",
    "verbose_option",
    "warn_of_empty_splits",
]

Command = TypeVar("Command", bound=Callable[..., Any])


compare_option = click.option(
    "--compare-paper/--no-compare-paper",
    default=None,
    help="Show the paper's published values beside the dataset's.  [default: for plan `paper` and its parts only]",
)
"""`--compare-paper`: on, off, or by the dataset's plan."""


def plan_argument(default: str | None) -> Callable[[Command], Command]:
    """PLAN: a built-in name or a TOML file."""
    return click.argument("plan_name", metavar="[PLAN]", required=False, default=default, shell_complete=_complete_plan)


def _complete_plan(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    names = [CompletionItem(name) for name in BUILTIN_PLANS if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


def shrink_options(command: Command) -> Command:
    """`--scene --episodes --expert --seed`: a smaller or differently driven plan."""
    for option in (
        click.option("--seed", type=click.IntRange(min=0), help="Another root seed."),
        click.option("--expert", type=click.Choice([str(name) for name in ExpertName]), help="Another expert."),
        click.option("--episodes", type=int, metavar="N", help="Shrink the plan to N episodes, proportions kept."),
        click.option("--scene", metavar="SCENE", help=f"Only this scene ({', '.join(BUILTIN_CATEGORIES)}, ...)."),
    ):
        command = option(command)
    return command


def shrunk_plan(plan: Plan, changes: Mapping[str, Any]) -> Plan:
    """Applies the shrink options to a plan."""
    expert = changes.get("expert")
    return shrink(
        plan,
        scene=changes.get("scene"),
        episodes=changes.get("episodes"),
        expert=ExpertName(expert) if expert else None,
        seed=changes.get("seed"),
    )


def warn_of_empty_splits(plan: Plan) -> None:
    """Says on stderr which splits get nothing of so few episodes: an evaluation would look for them."""
    empty = empty_splits(plan)
    if empty:
        click.echo(f"note: {plan.episodes} episodes are too few for a share of {', '.join(empty)}", err=True)


dataset_argument = click.argument("root", metavar="DIR", type=DIRECTORY)
"""DIR: a dataset directory."""

place_argument = click.argument("root", metavar="DIR|URL", type=PLACE)
"""DIR|URL: a dataset to read, in a directory or in object storage."""

site_argument = click.argument("site", metavar="DIR|URL", type=SITE)
"""DIR|URL: a run, by where its dataset lies."""

out_option = click.option(
    "--out",
    "site",
    required=True,
    metavar="DIR|URL",
    type=SITE,
    help="Dataset directory, or s3://BUCKET/NAME (gs://, az://), whose ledger and part files then lie in "
    "MINIVLA_STATE; resumed.",
)
"""`--out`: where the dataset is made."""

ledger_option = click.option(
    "--ledger", metavar="URL", envvar="MINIVLA_LEDGER", help="The ledger, when it is no ledger.db in its own place."
)
"""`--ledger URL`, or the environment's MINIVLA_LEDGER: a URL may hold a password, which a command line shows to all."""

tls_option = click.option(
    "--tls",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    envvar="MINIVLA_TLS",
    help="The TLS folder of this host, as `factory keys host` makes it.",
)
"""`--tls DIR`, or the environment's MINIVLA_TLS."""

renderer_option = click.option(
    "--renderer",
    type=click.Choice(get_args(RendererKind)),
    default="auto",
    show_default=True,
    help="OpenGL, PyBullet's TinyRenderer, or the first of them that works here.",
)
"""`--renderer auto|gl|tiny`."""

verbose_option = click.option("-v", "--verbose", is_flag=True, help="Log every event, not only warnings.")
