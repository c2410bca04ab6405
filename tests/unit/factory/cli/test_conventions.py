"""Checks on all commands: each concept has one spelling on the command line, and help imports no work."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import fields

import click
import pytest

from factory import cli as cli_package
from factory.cli.jobs import Reach
from factory.cli.main import VERBS, cli, main
from factory.cli.train import Training
from factory.runs.plan_changes import PlanChanges
from factory.web.http_options import HttpOptions
from tests.test_layering import PACKAGES, ROOT, imports_of

LINE = 80
SYNONYMS = {
    "--output": "-o/--out",
    "--save": "-o/--out",
    "--cache": "-o/--out",
    "--data": "DIR as an argument",
    "--dataset": "DIR as an argument",
    "--processes": "--workers",
    "--threads": "--workers",
    "--resume": "no option: a command that can continue a run continues it",
    "--overwrite": "--force",
    "--yes": "--force",
    "--splits": "--split",
    "--scenes": "--scene",
    "--tiers": "--tier",
    "--wait": "--...-timeout",
    "--quiet": "--verbose",
    "--random-seed": "--seed",
}
"""Spellings that no visible option may have, and what to use instead."""
DIFFERENT = {
    ("factory gate", "--scene"): "measures one scene",
    ("factory train bc", "--split"): "learns from one split",
    ("factory train policy", "--split"): "learns from one split",
    ("factory train rounds", "--split"): "evaluates on one split",
    ("factory correct", "--policy"): "corrects one policy",
    ("factory worker", "--policy"): "drives with one policy",
    ("factory keys ca", "--name"): "has a default",
    ("factory bench collect", "--expert"): "compares several experts",
    ("factory bench collect", "--record"): "compares both recordings",
    ("factory render", "--rig"): "renders several rigs",
    ("factory run", "--scenes"): "names a folder of packages",
    ("factory replay", "--scenes"): "names a folder of packages",
    ("factory eval compare", "--dataset"): "its arguments are results",
    ("factory relabel", "--language"): "takes a file; `factory stats` has a flag of this name",
    ("factory keys host", "--address"): "lists the addresses of one host",
    ("factory repair", "--plan"): "is an option, because the argument is the dataset",
}
"""Options that may be declared differently from the other options of the same name, and the reason."""
COLLECTED = {"changes": PlanChanges, "pages": HttpOptions, "reach": Reach, "training": Training}
"""Parameters of commands that collect the values of several options, and their types."""
UNTYPED = {"factory export"}
"""Commands that get options in a dict, because models generate these options."""
IMPORTED = "import sys; from factory.cli.main import cli, main\n{body}\nprint(*sorted(sys.modules), file=sys.stderr)"


def commands(command: click.Command = cli, path: str = "factory") -> Iterator[tuple[str, click.Command]]:
    yield path, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            yield from commands(found, f"{path} {name}")


def options(hidden: bool = False) -> Iterator[tuple[str, click.Option]]:
    for path, command in commands():
        for parameter in command.params:
            if isinstance(parameter, click.Option) and parameter.hidden == hidden:
                yield path, parameter


def shown(command: click.Command, path: str) -> str:
    context = click.Context(command, info_name=path, max_content_width=LINE, terminal_width=LINE)
    return command.get_help(context)


def test_the_command_table_has_the_summary_of_each_command() -> None:
    said = {
        name: command.help for name, command in ((n, cli.get_command(click.Context(cli), n)) for n in VERBS) if command
    }
    assert {name: (text or "").split("\n\n")[0] for name, text in said.items()} == {
        name: verb.summary for name, verb in VERBS.items()
    }


def test_the_docstring_of_each_module_names_its_command() -> None:
    for name in VERBS:
        module = importlib.import_module(f"factory.cli.{name}")
        assert (module.__doc__ or "").startswith(f"`factory {name}"), module.__name__


@pytest.mark.parametrize(("path", "command"), [found for found in commands() if isinstance(found[1], click.Group)])
def test_every_command_is_listed_with_its_whole_summary_on_one_line(path: str, command: click.Group) -> None:
    lines = [line.split(maxsplit=1) for line in shown(command, path).splitlines() if line.startswith("  ")]
    context = click.Context(command)
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None
        summary = " ".join((found.help or "").split("\n\n")[0].split())
        assert summary.endswith(".")
        if not found.hidden:
            assert [name, summary] in lines


def test_no_line_of_any_help_is_wider_than_80_columns() -> None:
    wide = [
        (path, line) for path, command in commands() for line in shown(command, path).splitlines() if len(line) > LINE
    ]
    assert wide == []


def test_every_option_has_a_help_sentence() -> None:
    texts = {f"{path} {option.opts[-1]}": (option.help or "").split(" [")[0] for path, option in options()}
    bad = {name for name, text in texts.items() if not text.endswith(".") or not (text[:1].isupper() or ":" in text)}
    assert bad == {f"{path} --renderer" for path, option in options() if "--renderer" in option.opts} & bad
    assert len(texts) > 120


def test_every_option_that_takes_a_value_names_it() -> None:
    silent = {
        f"{path} {option.opts[-1]}"
        for path, option in options()
        if not option.is_flag and option.metavar is None and not isinstance(option.type, click.Choice)
    }
    assert silent == set()


def test_every_option_name_follows_the_convention() -> None:
    assert {(path, name) for path, option in options() for name in option.opts if name in SYNONYMS} <= DIFFERENT.keys()


def test_every_option_for_an_output_is_spelt_o_and_out() -> None:
    spelt = {(path, tuple(option.opts)) for path, option in options() if {"-o", "--out"} & set(option.opts)}
    assert len(spelt) > 12
    assert {names for _, names in spelt} == {("-o", "--out")}


def test_options_of_the_same_name_are_declared_equally_in_every_command() -> None:
    kinds: dict[str, dict[tuple[object, ...], list[str]]] = defaultdict(lambda: defaultdict(list))
    for path, option in options():
        name = option.opts[-1]
        if (path, name) not in DIFFERENT:
            metavar = option.metavar if name != "--out" else None
            kinds[name][option.is_flag, option.multiple, metavar, tuple(option.opts)].append(path)
    assert {name: dict(found) for name, found in kinds.items() if len(found) > 1} == {}


def test_every_choice_is_a_plain_text() -> None:
    choices = {(path, *option.type.choices) for path, option in options() if isinstance(option.type, click.Choice)}
    # for an enum member, click would print and accept its name instead of its value
    assert not [found for found in choices if any(type(value) is not str for value in found)]


def test_names_of_repeatable_options_are_singular() -> None:
    filters = {option.opts[-1] for _, option in options() if option.multiple}
    assert not {name for name in filters if name.endswith("s") and name != "--address"}


def test_only_an_internal_option_is_hidden() -> None:
    assert {(path, *option.opts) for path, option in options(hidden=True)} == {("factory worker", "--until-eof")}


def parsed(*words: str) -> dict[str, object]:
    """Returns the parameters that a command line sets; runs no command."""
    context, rest = cli.make_context("factory", list(words)), list(words)
    while isinstance(context.command, click.Group):
        name, command, rest = context.command.resolve_command(context, [*context._protected_args, *context.args])
        assert command is not None
        context = command.make_context(name, rest, parent=context)
    return context.params


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (("jobs", "list", "D", "--tier", "near", "--tier", "mid"), ("jobs", "list", "D", "--tier", "near,mid")),
        (("run", "--out", "D"), ("run", "-o", "D")),
    ],
)
def test_a_repeated_option_and_a_list_with_commas_give_the_same_arguments(
    one: tuple[str, ...], other: tuple[str, ...]
) -> None:
    assert parsed(*one) == parsed(*other)


def run(words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> int:
    """Runs the whole command line in this process; returns the exit code."""
    monkeypatch.setattr(sys, "argv", ["factory", *words])
    with pytest.raises(SystemExit) as left:
        main()
    return int(left.value.code or 0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("stauts",), "No such command 'stauts'; did you mean 'stats' or 'status'?"),
        (("jobs", "retri"), "No such command 'retri'; did you mean 'retry'?"),
        (("scene", "imprt"), "No such command 'imprt'; did you mean 'import'?"),
        (("bench", "rolout"), "No such command 'rolout'; did you mean 'rollout'?"),
        (("bench", "coordinator", "--json"), "in a checkout of the repository: python -m tests.benchmarks.coordinator"),
        (("bench", "serve", "--help"), "in a checkout of the repository: python -m tests.benchmarks.serve"),
        (("eval", "D", "--policies", "stop"), "No such option '--policies'; did you mean '--policy'"),
        (("jobs", "list", "D", "--teir", "near"), "No such option '--teir'; did you mean '--tier'"),
        (("eval", "D", "--dat", "x"), "No such option '--dat'"),
        (("train", "bc", "D", "-o", "O", "--resum"), "No such option '--resum'"),
    ],
)
def test_a_misspelled_command_or_option_is_answered_with_the_closest_visible_name(
    words: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words, monkeypatch) == 2
    text = capsys.readouterr().err
    assert said in text
    assert "--data" not in text
    assert "--resume" not in text


def work_of(*verbs: str) -> set[str]:
    """Returns the modules of the product that the modules of commands import to execute them."""
    names = {name for verb in verbs for name in imports_of(ROOT / "factory" / "cli" / f"{verb}.py")}
    return {name for name in names if name.startswith(PACKAGES) and not name.startswith("factory.cli")}


def loaded_by(body: str) -> set[str]:
    """Returns the modules that a process has imported after it has run some lines of code."""
    command = [sys.executable, "-c", IMPORTED.format(body=body)]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stderr.split())


@pytest.mark.parametrize(
    "body",
    [
        "cli.main(['--help'], standalone_mode=False)",
        "cli.main(['-h'], standalone_mode=False)",
        "from click.shell_completion import ShellComplete\n"
        "found = ShellComplete(cli, {}, 'factory', '_FACTORY_COMPLETE').get_completions([], 'st')\n"
        "assert [item.value for item in found] == ['status', 'stats'], found",
        "cli.main(['completion', 'bash'], standalone_mode=False)",
    ],
)
def test_help_and_completion_import_no_command_and_no_heavy_package(body: str) -> None:
    loaded = loaded_by(body)
    assert "factory.cli.main" in loaded
    assert {f"factory.cli.{name}" for name in VERBS} & loaded <= {"factory.cli.completion"}
    assert {
        "pydantic",
        "numpy",
        "rich",
        "sqlalchemy",
        "zenoh",
        "pybullet",
        "PIL",
        "structlog",
        "yaml",
    } & loaded == set()


def test_help_imports_no_package_that_only_the_work_of_a_command_needs() -> None:
    body = "import click\n"
    body += "def walk(command, parent):\n"
    body += "    context = click.Context(command, parent=parent)\n"
    body += "    assert command.get_help(context)\n"
    body += "    for name in getattr(command, 'list_commands', lambda _: ())(context):\n"
    body += "        walk(command.get_command(context, name), context)\n"
    body += "walk(cli, None)"
    loaded = loaded_by(body)
    assert {f"factory.cli.{name}" for name in VERBS} <= loaded
    assert loaded & {"factory.runs.local", "coordinator.service", "workers.client.host"} == set()
    assert (
        loaded & {"numpy", "scipy", "pyarrow", "PIL", "rich", "sqlalchemy", "structlog", "zenoh", "pybullet"} == set()
    )


def test_the_function_of_every_command_takes_the_options_of_the_command() -> None:
    checked = 0
    for path, command in commands():
        if isinstance(command, click.Group) or command.callback is None:
            continue
        signature = inspect.signature(inspect.unwrap(command.callback))
        names = {str(parameter.name) for parameter in command.params if parameter.expose_value}
        for value, kind in COLLECTED.items():
            if value in signature.parameters:
                collected = names & {field.name for field in fields(kind)}
                assert collected, (path, value)
                names = names - collected | {value}
        signature.bind(**dict.fromkeys(names))  # raises TypeError if they differ
        kinds = {parameter.kind for parameter in signature.parameters.values()}
        assert (inspect.Parameter.VAR_KEYWORD in kinds) == (path in UNTYPED), path
        checked += 1
    assert checked > 45


def test_commands_import_scipy_submodules_lazily() -> None:
    loaded = loaded_by("import " + ", ".join(sorted(work_of(*set(VERBS) - {"scene"}))))  # a survey needs scipy
    assert "factory.stats.measures" in loaded
    assert {"scipy.stats", "scipy.ndimage", "scipy.sparse", "scipy.spatial"} & loaded == set()


def test_the_commands_that_generate_data_are_imported_without_pybullet() -> None:
    loaded = loaded_by("import " + ", ".join(sorted(work_of("run", "gate", "render", "coordinator"))))
    assert "factory.runs.local" in loaded
    assert "pybullet" not in loaded  # without it, the commands name the Python versions that can install it


def commands_below(command: click.Command) -> Iterator[click.Command]:
    yield command
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            yield from commands_below(inner)


def test_every_command_of_a_module_belongs_to_a_verb() -> None:
    found = pkgutil.walk_packages(cli_package.__path__, "factory.cli.")
    modules = [importlib.import_module(info.name) for info in found if not info.ispkg]
    verbs = [importlib.import_module(f"factory.cli.{name}").command for name in VERBS]
    reached = {id(command) for verb in verbs for command in commands_below(verb)}
    assert len(verbs) == len(VERBS)
    assert [module.__name__ for module in modules if id(getattr(module, "command", verbs[0])) not in reached] == []


@pytest.mark.parametrize("words", [("eval", "--help"), ("eval", "D", "--help"), ("eval", "run", "--help")])
def test_the_help_of_a_verb_with_a_default_shows_its_options(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words, monkeypatch) == 0
    text = capsys.readouterr().out
    assert text.startswith("Usage: factory eval [OPTIONS] DIR\n")
    assert "--policy [NAME=]POLICY" in text
