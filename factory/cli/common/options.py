"""Options and arguments that several commands share."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

import click
from click.shell_completion import CompletionItem

from coordinator.defaults import MAX_PULLERS, pullers_for
from factory.cli.common.filters import scene_filter
from factory.cli.common.places import DIRECTORY, PLACE, SITE
from schemas.builtin import BUILTIN_APPEARANCES, BUILTIN_PLAN_NAMES, BUILTIN_RIGS, NO_APPEARANCE
from schemas.terms import ExpertName, Recording, RendererKind

Command = TypeVar("Command", bound=Callable[..., Any])


compare_option = click.option(
    "--compare-paper/--no-compare-paper",
    default=None,
    help="Show the published values of the paper next to those of the dataset. Default: only for the plan `paper`.",
)
"""`--compare-paper`: on, off, or chosen by the dataset's plan."""


def plan_argument(default: str | None) -> Callable[[Command], Command]:
    """Returns the argument PLAN: a built-in name or a TOML file."""
    return click.argument("plan_name", metavar="[PLAN]", required=False, default=default, shell_complete=_complete_plan)


def _complete_plan(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    names = [CompletionItem(name) for name in BUILTIN_PLAN_NAMES if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


plan_seed_option = click.option(
    "--seed", type=click.IntRange(0), metavar="N", help="Root random seed. Default: the plan's."
)
"""`--seed N`: replaces the plan's seed."""


record_option = click.option(
    "--record",
    type=click.Choice([str(kind) for kind in Recording]),
    help="Stored content: frames, or states, from which readers render frames. Default: the plan's.",
)
"""`--record frames|states`: replaces the plan's recording."""


def complete_rig(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Completes the name of a built-in rig; if none begins with the word, the shell completes file names."""
    names = [CompletionItem(name) for name in BUILTIN_RIGS if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


def rig_option(text: str, multiple: bool = False) -> Callable[[Command], Command]:
    """Returns the option `--rig RIG`: the name of a built-in rig, or a TOML file."""
    name = "rigs" if multiple else "rig"
    return click.option("--rig", name, metavar="RIG", multiple=multiple, shell_complete=complete_rig, help=text)


def complete_appearance(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Completes the name of a built-in appearance; if none begins with the word, the shell completes file names."""
    names = [CompletionItem(name) for name in (*BUILTIN_APPEARANCES, NO_APPEARANCE) if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


def appearance_option(default: str) -> Callable[[Command], Command]:
    """Returns the option `--appearance NAME|FILE`.

    Args:
        default: effect of the default, as a sentence.
    """
    text = f"Appearance of the frames: {', '.join(BUILTIN_APPEARANCES)}, {NO_APPEARANCE}, or a TOML file. {default}"
    return click.option("--appearance", metavar="NAME|FILE", shell_complete=complete_appearance, help=text)


def shrink_options(command: Command) -> Command:
    """Adds `--scene --episodes --expert --seed --record --rig --appearance`, which change these values of a plan."""
    for option in (
        appearance_option("Default: the plan's."),
        rig_option("Sensor rig: a built-in name or a TOML file; `paper` is the recorded camera. Default: the plan's."),
        record_option,
        plan_seed_option,
        expert_option,
        count_option(
            "--episodes", None, "Number of episodes, in the plan's proportions. Default: all episodes of the plan."
        ),
        scene_filter(),
    ):
        command = option(command)
    return command


dataset_argument = click.argument("root", metavar="DIR", type=DIRECTORY)
"""DIR: a dataset directory."""

place_argument = click.argument("root", metavar="DIR|URL", type=PLACE)
"""DIR|URL: a dataset to read, in a directory or in object storage."""

site_argument = click.argument("site", metavar="DIR|URL", type=SITE)
"""DIR|URL: a run, given by the location of its dataset."""

out_option = click.option(
    "-o",
    "--out",
    "site",
    required=True,
    metavar="DIR|URL",
    type=SITE,
    help="Dataset directory, or URL s3://BUCKET/NAME (also gs://, az://); for a URL, the ledger and temporary files "
    "are stored in MINIVLA_STATE. An existing dataset is continued.",
)
"""`--out`: location of the dataset."""

ledger_option = click.option(
    "--ledger",
    metavar="URL",
    envvar="MINIVLA_LEDGER",
    help="URL of the ledger's database. Default: MINIVLA_LEDGER, else ledger.db in the dataset directory.",
)
"""`--ledger URL`, or MINIVLA_LEDGER, because a password in the URL would be visible in the command line."""

tls_option = click.option(
    "--tls",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    envvar="MINIVLA_TLS",
    help="TLS folder of this host, created by `factory keys host`. Default: MINIVLA_TLS, else no TLS.",
)
"""`--tls DIR`, or MINIVLA_TLS."""

renderer_option = click.option(
    "--renderer",
    type=click.Choice(get_args(RendererKind)),
    default="auto",
    show_default=True,
    help="Renderer. gl: OpenGL; tiny: PyBullet's TinyRenderer; auto: OpenGL if it works on this machine, else tiny.",
)
"""`--renderer auto|gl|tiny`."""

expert_option = click.option(
    "--expert", type=click.Choice([str(name) for name in ExpertName]), help="Expert controller. Default: the plan's."
)
"""`--expert NAME`: replaces the plan's expert."""

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
"""`--json`: prints the result as JSON."""

verbose_option = click.option("-v", "--verbose", is_flag=True, help="Log all events. Default: warnings only.")
"""`--verbose`."""


def workers_option(
    text: str, default: int | None = None, least: int = 1, unset: str = "one per core"
) -> Callable[[Command], Command]:
    """Returns the option `--workers N`: number of processes. If `default` is `None`, the help shows `unset`."""
    return click.option(
        "--workers",
        type=click.IntRange(least, 1024),
        default=default,
        show_default=default is not None,
        metavar="N",
        help=text if default is not None else f"{text}. Default: {unset}.",
    )


def pullers_option() -> Callable[[Command], Command]:
    """Returns the option `--pullers N`."""
    return click.option(
        "--pullers",
        type=click.IntRange(1, MAX_PULLERS),
        default=lambda: pullers_for(os.cpu_count() or 1),
        metavar="N",
        help="Number of bundles that are transferred and validated at a time, each in a process. Default: one per "
        "core, at least 2.",
    )


def count_option(
    flag: str, default: int | None, text: str, *, least: int = 1, most: int | None = None
) -> Callable[[Command], Command]:
    """Returns an option with an integer value that shows its default, unless the default is `None`."""
    shows = default is not None
    return click.option(
        flag, type=click.IntRange(least, most), default=default, show_default=shows, metavar="N", help=text
    )


def number_option(
    metavar: str, flag: str, default: float | None, text: str, *names: str, least: float, most: float | None = None
) -> Callable[[Command], Command]:
    """Returns an option with a decimal value that shows its default, unless the default is `None`."""
    kind, shows = click.FloatRange(least, most), default is not None
    return click.option(flag, *names, type=kind, default=default, show_default=shows, metavar=metavar, help=text)


def write_option(
    metavar: str, text: str, name: str = "out", *, required: bool = False, **checks: bool
) -> Callable[[Command], Command]:
    """Returns the option `--out`: the file or folder to write.

    Args:
        metavar: FILE or DIR.
        text: help text.
        name: name of the parameter.
        required: True if the option has no default.
        checks: arguments of `click.Path`.
    """
    kind = click.Path(path_type=Path, **checks)
    return click.option("-o", "--out", name, type=kind, metavar=metavar, required=required, help=text)


def connect_option(text: str, required: bool = False) -> Callable[[Command], Command]:
    """Returns the option `--connect ENDPOINT`, repeatable; values may also be separated by commas."""
    return click.option(
        "--connect", multiple=True, required=required, metavar="ENDPOINT", callback=_split_commas, help=text
    )


def listen_option(text: str) -> Callable[[Command], Command]:
    """Returns the option `--listen ENDPOINT`, repeatable; values may also be separated by commas."""
    return click.option("--listen", multiple=True, metavar="ENDPOINT", callback=_split_commas, help=text)


def _split_commas(context: click.Context, param: click.Parameter, given: tuple[str, ...]) -> tuple[str, ...]:  # noqa: ARG001
    return tuple(part.strip() for one in given for part in one.split(",") if part.strip())


def former_option(old: str, name: str, new: str, **like: Any) -> Callable[[Command], Command]:
    """Returns a hidden option: the former spelling of another option or of an argument.

    Args:
        old: the former spelling, e.g. `--data`.
        name: name of the parameter that it sets.
        new: the current spelling, for the help and for the error when both are given.
        like: other arguments of `click.option`.
    """
    own = f"former_{old.lstrip('-').replace('-', '_')}"

    def set_it(context: click.Context, param: click.Parameter, value: Any) -> None:  # noqa: ARG001
        if context.get_parameter_source(own) is click.core.ParameterSource.COMMANDLINE:
            context.default_map = {**(context.default_map or {}), name: value}

    def decorate(verb: Command) -> Command:
        @functools.wraps(verb)
        def checked(*args: Any, **kwargs: Any) -> Any:
            context = click.get_current_context()
            if all(context.get_parameter_source(key) is click.core.ParameterSource.COMMANDLINE for key in (own, name)):
                context.fail(f"{old} is the former spelling of {new}; give {new} only")
            return verb(*args, **kwargs)

        option = click.option(
            old,
            own,
            hidden=True,
            is_eager=True,
            expose_value=False,
            callback=set_it,
            help=f"Deprecated alias of {new}.",
            **like,
        )
        return cast("Command", option(checked))

    return decorate
