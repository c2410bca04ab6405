"""Options and arguments that several commands share, and their types. Opens no dataset and measures nothing."""

from __future__ import annotations

import functools
import os
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args

import click
from click.shell_completion import CompletionItem

from coordinator.defaults import MAX_PULLERS, pullers_for, usable_cores
from factory.dataset.site import Site, dataset_directory, site_of
from factory.runs.gate_mode import GATE_ATTEMPTS, MIN_EPISODES_FOR_GATE, MIN_SUCCESS, GateMode
from factory.runs.plan_changes import PlanChanges
from factory.train.input_size import SIZES
from factory.web.http_options import HttpOptions
from schemas.builtin import BUILTIN_APPEARANCES, BUILTIN_PLAN_NAMES, BUILTIN_RIGS, NO_APPEARANCE
from schemas.storage.dataset_files import EPISODES, SCENES
from schemas.storage.place import Place, place_of
from schemas.support.extras import require_package
from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES, ExpertName, Recording, RendererKind, Split, Tier, family_of

if TYPE_CHECKING:
    from schemas.dataset.run_shard import RunShard

Command = TypeVar("Command", bound=Callable[..., Any])
ALL = "all"
"""The value of a filter that selects everything."""
_GATE_MODES = (
    f"Gate before a new run: {GATE_ATTEMPTS} first attempts in each scene. enforce: exit with 1 if less than "
    f"{100 * MIN_SUCCESS:.0f} % succeed; report: record the result and continue; skip: no gate"
)


def _folders(word: str) -> list[CompletionItem]:
    """Tells the shell to complete directory names; URLs are not completed."""
    return [CompletionItem(word, type="dir")]


class _SiteType(click.ParamType[Site]):
    name = "directory or URL"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return _folders(incomplete)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Site:  # noqa: ARG002
        return value if isinstance(value, Site) else site_of(value)


class _PlaceType(click.ParamType[Place]):
    name = "directory or URL"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return _folders(incomplete)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Place:  # noqa: ARG002
        return place_of(value)


class _DirectoryType(click.ParamType[Path]):
    name = "directory"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return _folders(incomplete)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:  # noqa: ARG002
        return dataset_directory(value, "this command" if ctx is None else f"`{ctx.command_path}`")


_MOST_COMPLETIONS = 200


class _ShardType(click.ParamType):  # type: ignore[type-arg]  # its type is imported only to convert a value
    name = "shard"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> RunShard:  # noqa: ARG002
        from schemas.dataset.run_shard import RunShard, parse_shard

        return value if isinstance(value, RunShard) else parse_shard(value)


SHARD = _ShardType()
"""A shard of a run, e.g. `7/200`."""
SITE = _SiteType()
"""A run: the locations of its dataset and its ledger."""
PLACE = _PlaceType()
"""A dataset to read."""
DIRECTORY = _DirectoryType()
"""A dataset in a local directory."""


class _Names(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """`A[,B...]` as a tuple of names, checked against the valid names if they are known; `all` is an empty tuple."""

    def __init__(self, name: str, known: Sequence[str] = ()) -> None:
        self.name = name
        self._known = known

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Returns the names; an unknown name is a usage error."""
        if isinstance(value, tuple):
            return value
        names = tuple(name.strip() for name in str(value).split(",") if name.strip())
        if ALL in names:
            return ()
        unknown = [name for name in names if self._known and name not in self._known]
        if unknown or not names:
            valid = f"valid values: {', '.join(self._known)}, {ALL}" if self._known else f"give a name, or {ALL}"
            near = did_you_mean("".join(unknown[:1]), (*self._known, ALL))
            what = f"unknown {self.name} {', '.join(map(repr, unknown))}" if unknown else "empty value"
            self.fail(f"{what}; {valid}{near}", param, ctx)
        return names

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Completes the last name in the list."""
        before, comma, last = incomplete.rpartition(",")
        known = self._known if self.name != "scene" else sorted({*BUILTIN_CATEGORIES, *_scenes_in(_dataset_of(ctx))})
        return [CompletionItem(f"{before}{comma}{name}") for name in known if name.startswith(last)]


def _dataset_of(context: click.Context) -> Path | None:
    """Returns the local dataset that a command line names so far; `None` if it names none."""
    for name in ("root", "site", "dataset", "data"):
        given = context.params.get(name)
        folder = getattr(given, "state_dir", given)
        if isinstance(folder, str | Path) and Path(folder).is_dir():
            return Path(folder)
    names = context.params.get("names") or ()  # of `replay`, whose first argument is a dataset or an episode
    if names and Path(names[0]).is_dir():
        return Path(names[0])
    # click parses no argument of a line that ends with an option without its value; the shell passes the whole line
    words = shlex.split(os.environ.get("COMP_WORDS", "").replace("'", "").replace('"', ""))
    return next((Path(word) for word in words if (Path(word) / EPISODES).is_dir()), None)


def _scenes_in(root: Path | None) -> set[str]:
    """Returns the scenes of a dataset, and the families of its layouts, from the names of its scene packages."""
    if root is None:
        return set()
    names = {path.name.removesuffix(".scene.zip").rpartition("-")[0] for path in (root / SCENES).glob("*.scene.zip")}
    return names | {family_of(name) for name in names}


def episode_argument(function: Command) -> Command:
    """`EPISODE` as `episode`: a name or number, which the shell completes."""
    return click.argument("episode", shell_complete=complete_episode)(function)


def complete_episode(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Returns the episodes of the dataset on the command line whose names begin with a word."""
    root = _dataset_of(context)
    if root is None:
        return []
    prefix = word if word.startswith("ep_") else f"ep_{word.zfill(6)}" if word.isdigit() else "ep_"
    names = {path.name.partition(".")[0] for path in (root / EPISODES).glob(f"{prefix}*")}
    return [CompletionItem(name) for name in sorted(names)[:_MOST_COMPLETIONS]]


def filter_option(
    flag: str,
    name: str,
    known: Iterable[str] = (),
    text: str | None = None,
) -> Callable[[Command], Command]:
    """Returns an option whose values are collected in one tuple: `None` when not given, empty for `all`.

    Args:
        flag: the option, e.g. `--split`.
        name: name of the parameter.
        known: valid values; empty when they are not known in advance.
        text: help text; by default a text that lists the valid values.
    """
    word, names = flag.lstrip("-"), tuple(map(str, known))
    return click.option(
        flag,
        name,
        multiple=True,
        type=_Names(word, names),
        metavar=word.upper(),
        callback=_flatten,
        help=text or f"{word.capitalize()} to include; repeatable. Values: {', '.join(names)}. Default: all.",
    )


def split_filter(text: str | None = None) -> Callable[[Command], Command]:
    """`--split SPLIT` as `splits`."""
    return filter_option("--split", "splits", Split, text)


def tier_filter() -> Callable[[Command], Command]:
    """`--tier TIER` as `tiers`."""
    return filter_option("--tier", "tiers", Tier)


def scene_filter() -> Callable[[Command], Command]:
    """`--scene SCENE` as `scenes`. Names are not checked, because imported scenes can have any name."""
    known = ", ".join(BUILTIN_CATEGORIES)
    return filter_option("--scene", "scenes", (), f"Scene to include; repeatable. Built-in: {known}. Default: all.")


def _flatten(context: click.Context, param: click.Parameter, given: Any) -> tuple[str, ...] | None:  # noqa: ARG001
    if not given:
        return None
    if () in given:
        return ()
    return tuple(dict.fromkeys(name for names in given for name in names))


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
        default=lambda: pullers_for(usable_cores()),
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


input_size_option = click.option(
    "--size",
    type=click.Choice([str(size) for size in SIZES]),
    default="128",
    show_default=True,
    metavar="N",
    help=f"Width and height of the input image, pixels: {', '.join(map(str, SIZES))}.",
)
"""`--size N` of a training."""


def policy_limit_options(command: Command) -> Command:
    """Adds `--act-timeout` and `--load-timeout`: time limits of a policy."""
    act = number_option("SECONDS", "--act-timeout", 10.0, "Timeout for each action, seconds.", least=0.01)
    text = "Timeout for loading the policy and for each reset, seconds."
    return act(number_option("SECONDS", "--load-timeout", 300.0, text, least=0.1)(command))


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


def gate_option(default: GateMode) -> Callable[[Command], Command]:
    """Returns the option `--gate MODE`."""
    modes = ["enforce", "report", "skip"]
    if default == "auto":
        modes.insert(0, default)
    auto = (
        f"; auto: report for scenes with at least {MIN_EPISODES_FOR_GATE} episodes, otherwise skip"
        if default == "auto"
        else ""
    )
    return click.option(
        "--gate",
        "gate_mode",
        type=click.Choice(modes),
        default=default,
        show_default=True,
        help=f"{_GATE_MODES}{auto}.",
    )


def collected(command: Command, name: str, kind: type[Any]) -> Command:
    """Passes the parameters that are fields of `kind` to a command as one value with the name `name`."""
    names = [field.name for field in fields(kind)]

    @functools.wraps(command)
    def collect(**values: Any) -> Any:
        value = kind(**{field: values.pop(field) for field in names if field in values})
        return command(**values, **{name: value})

    return cast("Command", collect)


def shrink_options(command: Command) -> Command:
    """Adds `--scene --episodes --expert --seed --record --rig --appearance` as `changes`: changes of a plan."""
    command = collected(command, "changes", PlanChanges)
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


def http_options(command: Command) -> Command:
    """Adds `--http HOST:PORT --http-token FILE --host-name NAME` as `pages`."""
    return _http_options(collected(command, "pages", HttpOptions))


def run_http_options(command: Command) -> Command:
    """Adds `--http HOST:PORT --http-token FILE --host-name NAME --eval DIR` of a run as `pages`."""
    return _http_options(evaluations_option(collected(command, "pages", HttpOptions)))


def host_name_option(command: Command) -> Command:
    """`--host-name NAME`, repeatable, as `host_names`."""
    return click.option(
        "--host-name",
        "host_names",
        multiple=True,
        metavar="NAME",
        callback=_split_commas,
        help="Name under which clients reach the pages, e.g. of an ingress or a service; repeatable. Requests "
        "for other names are refused with 421. Default: loopback names and the address of --http.",
    )(command)


def _http_options(command: Command) -> Command:
    for option in (
        host_name_option,
        click.option(
            "--http-token",
            type=click.Path(path_type=Path, dir_okay=False),
            metavar="FILE",
            help="File whose first line is the token of the pages; /healthz and /readyz need no token. "
            "Required if --http is not a loopback address.",
        ),
        click.option(
            "--http",
            metavar="HOST:PORT",
            callback=_require_pages,
            help="Address to serve the status pages /healthz, /readyz and /metrics on; a run also serves its web page "
            "if the extra `web` is installed. Default: no pages.",
        ),
    ):
        command = option(command)
    return command


def evaluations_option(command: Command) -> Command:
    """`--eval DIR`."""
    return click.option(
        "--eval",
        "evaluations",
        type=click.Path(path_type=Path, file_okay=False),
        metavar="DIR",
        multiple=True,
        help="Output directory of `factory eval` to show on the web page; repeatable. Default: none.",
    )(command)


def _require_pages(context: click.Context, param: click.Parameter, http: str | None) -> str | None:  # noqa: ARG001
    if http is not None:
        require_package("prometheus_client", "--http")
        require_package("uvicorn", "--http")
    return http
