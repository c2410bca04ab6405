"""All commands: every option has a help text, every result is available as JSON, shell completion works."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

from factory.cli.main import cli, main
from factory.support.settings import scene_cache
from schemas.errors import UsageError

SERVERS = {"factory coordinator start", "factory gateway start", "factory serve", "factory worker"}
"""Commands that run until they are stopped, and print the address to connect to."""


def verbs(command: click.Command = cli, path: str = "factory") -> Iterator[tuple[str, click.Command]]:
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            yield from verbs(found, f"{path} {name}")
    if not isinstance(command, click.Group) or command.invoke_without_command:
        yield path, command


def complete(*words: str) -> list[tuple[str, str]]:
    shell = ShellComplete(cli, {}, "factory", "_FACTORY_COMPLETE")
    return [(item.type, item.value) for item in shell.get_completions(list(words[:-1]), words[-1])]


def test_every_option_of_every_command_has_a_help_text() -> None:
    silent = [
        f"{path} {parameter.opts[0]}"
        for path, verb in verbs()
        for parameter in verb.params
        if isinstance(parameter, click.Option) and not (parameter.help or parameter.hidden)
    ]
    assert silent == []


def test_every_command_that_prints_a_result_can_print_json() -> None:
    without = {path for path, verb in verbs() if "as_json" not in {parameter.name for parameter in verb.params}}
    assert without == SERVERS | {"factory completion"}


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("status", "da"), [("dir", "da")]),
        (("verify", "da"), [("dir", "da")]),
        (("eval", "da"), [("dir", "da")]),
        (("run", "pa"), [("plain", "paper")]),
        (("run", "my_"), [("file", "my_")]),
        (("scene", "inspect", "hos"), [("plain", "hospital")]),
        (("scene", "inspect", "my_"), [("file", "my_")]),
        (("export", "dataset", "--to", "gn"), [("plain", "gnm")]),
        (("render", "dataset", "--rig", "pan"), [("plain", "panorama")]),
        (("run", "--rig", "turtle"), [("plain", "turtlebot4")]),
        (("eval", "dataset", "--rig", "mine"), [("file", "mine")]),
    ],
)
def test_the_shell_completes_folders_plans_scenes_and_formats(words: tuple[str, ...], found: list[object]) -> None:
    assert complete(*words) == found


@pytest.mark.parametrize(("name", "closest"), [("RLDS", "rlds"), ("lerobt", "lerobot")])
def test_the_error_of_an_unknown_format_suggests_the_closest_format(name: str, closest: str) -> None:
    with pytest.raises(
        UsageError, match=f"unknown format '{name}'; valid formats: paper, .*; did you mean '{closest}'"
    ):
        cli.main(["export", ".", "--to", name, "-o", "nowhere"], standalone_mode=False)


@pytest.mark.parametrize("stroke", [KeyboardInterrupt, click.exceptions.Abort])
def test_ctrl_c_prints_how_to_resume(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], stroke: type[BaseException]
) -> None:
    def interrupted(**_: object) -> None:
        raise stroke

    monkeypatch.setattr(cli, "main", interrupted)
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 130
    assert "run the same command again to continue" in capsys.readouterr().err


def test_the_shell_completes_the_names_of_imported_scenes() -> None:
    folder = scene_cache()
    folder.mkdir(parents=True)
    (folder / "home_lab-0123456789ab.scene.zip").write_bytes(b"")
    assert complete("scene", "survey", "ho") == [("plain", "hospital"), ("plain", "home"), ("plain", "home_lab")]


def test_the_shell_completes_episodes_and_scenes_of_the_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("episodes/ep_000001.zip", "episodes/ep_000012.zip", "scenes/home_00004-0123456789ab.scene.zip"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    root = str(tmp_path)
    assert complete("show", root, "ep_") == [("plain", "ep_000001"), ("plain", "ep_000012")]
    assert complete("replay", root, "12") == [("plain", "ep_000012")]
    monkeypatch.setenv("COMP_WORDS", f"factory jobs list {root} --scene ho")  # as a shell sets it
    assert complete("jobs", "list", root, "--scene", "home_") == [("plain", "home_00004")]
    assert ("plain", "home") in complete("jobs", "list", root, "--scene", "ho")
