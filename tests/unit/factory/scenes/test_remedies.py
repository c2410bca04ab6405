"""Every remedy that the import prints exists: options of its command, commands of the product, and other programs."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from factory.cli.main import cli
from factory.scenes.rules import builtin_rules, load_rules
from factory.scenes.stage_file import find_fault
from schemas.errors import UsageError
from tests.builders.pages import ROOT, parse_line

SOURCES = [
    path
    for path in sorted((ROOT / "factory" / "scenes").rglob("*.py"))
    if not {"author", "light", "pictures"} & set(path.relative_to(ROOT).parts)
]
PROGRAMS = {
    "npx @gltf-transform/cli copy": "run with 4.5.1: decodes Draco and meshopt (office-077b4007.glb of website-2k25)",
    "npx @gltf-transform/cli ktxdecompress": "run with 4.5.1: asks for the program ktx, which the message names",
    "xacro FILE -o FILE": "run with xacro 2.1.1; xacro FILE > FILE would empty the file",
    "blender --background": "not run; its expression is parsed below, its operators are those of Blender 4",
    "git lfs pull": "command of git-lfs 3; not run, because it needs a server with the files",
    "cp": "run in test_the_command_for_missing_rules_writes_a_file_that_is_read",
}
"""Programs outside of the product that messages name, each with how it was tried."""
_PROGRAM = re.compile(r"npx \S+|xacro(?= FILE)|blender --\w+|git lfs \w+|\w+checker|(?:apt|pip) install \S+")
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
_FACTORY = re.compile(r"factory [a-z]+(?: [a-z]+)?")


def texts() -> Iterator[tuple[str, str]]:
    """Yields file and text of each string that is not a docstring; expressions of f-strings are replaced by FILE."""
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                parts = (one.value if isinstance(one, ast.Constant) else "FILE" for one in node.values)
                yield str(path.relative_to(ROOT)), "".join(map(str, parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs | inner:
                yield str(path.relative_to(ROOT)), node.value


def command(*words: str) -> click.Command:
    found: click.Command = cli
    for word in words:
        assert isinstance(found, click.Group)
        inner = found.get_command(click.Context(found), word)
        assert inner is not None, f"factory {' '.join(words)} does not exist"
        found = inner
    return found


def options(found: click.Command) -> set[str]:
    return {name for parameter in found.params for name in (*parameter.opts, *parameter.secondary_opts)}


def test_every_option_of_a_message_is_an_option_of_the_import() -> None:
    known = options(command("scene", "import")) | {"--background", "--python-expr"}
    known |= (
        options(command("scene", "build")) | options(command("scene", "survey")) | options(command("scene", "render"))
    )
    used = {(place, option) for place, text in texts() for option in _OPTION.findall(text)}
    assert {(place, option) for place, option in used if option not in known} == set()
    assert {"--floor", "--unit", "--up", "--rules", "--targets", "--name", "--skip-missing", "--allow-outside"} <= {
        option for _, option in used
    }


def test_every_command_of_the_product_in_a_message_exists() -> None:
    used = {found for _, text in texts() for found in _FACTORY.findall(text)}
    assert used
    for words in used:
        command(*words.split()[1:])


def test_every_other_program_in_a_message_is_one_that_was_tried() -> None:
    used = {found for _, text in texts() for found in _PROGRAM.findall(text)}
    assert used
    assert all(any(name.startswith(found) for name in PROGRAMS) for found in used), used
    assert not any(re.search(r"xacro FILE\s*>", text) for _, text in texts())


@pytest.mark.parametrize(("suffix", "head"), [(".fbx", b"Kaydara FBX Binary"), (".blend", b"BLENDER-v300")])
def test_the_expression_for_blender_is_python(tmp_path: Path, suffix: str, head: bytes) -> None:
    path = tmp_path / f"it's a room{suffix}"
    path.write_bytes(head)
    (expression,) = re.findall(r"--python-expr (.*)$", find_fault(path))
    ast.parse(shlex.split(expression)[0])


def test_the_command_for_missing_rules_writes_a_file_that_is_read(tmp_path: Path) -> None:
    path = tmp_path / "my rules.yaml"
    with pytest.raises(UsageError) as caught:
        load_rules(path)
    (line,) = re.findall(r"`(cp [^`]*)`", str(caught.value))
    subprocess.run(line, shell=True, check=True)
    assert load_rules(path) == builtin_rules()


def test_the_steps_after_an_import_are_valid_commands() -> None:
    for line in ("scene inspect room -o room.png", "scene survey room", "plan show room.toml", "scene targets room"):
        parse_line(line.split())
