"""Checks the documents: links, anchors, cited paths and commands are valid, and no external document is cited."""

from __future__ import annotations

import ast
import json
import re
import shlex
from pathlib import Path
from urllib.parse import unquote

import pytest

from tests.builders.pages import PAGES, ROOT, anchors_of, factory_lines, links_of, make_lines, parse_line

LIMITS = {"README.md": 900, "ARCHITECTURE.md": 1500}
PACKAGES = ("minivla", "schemas", "workers", "coordinator", "factory")
SOURCES = sorted(
    path
    for folder in (*PACKAGES, "tests", "docs", "deploy")
    for suffix in ("py", "toml", "yaml", "yml", "html", "sh", "css", "service")
    for path in (ROOT / folder).rglob(f"*.{suffix}")
)
CITING = [*PAGES, *SOURCES, ROOT / "Makefile", ROOT / "pyproject.toml", ROOT / ".github"]
HISTORY = ROOT / "CHANGELOG.md"
"""Each entry keeps the names and paths that were valid at its date."""
OTHERS = re.compile(r"\b(DESIGN|STYLE) \d|\b(DESIGN|STYLE)\.md|\bnotes/|\bnotes of the project")
"""Citations of documents that are not in the repository."""
PATH = re.compile(rf"(?<![\w./:\-])((?:{'|'.join(PACKAGES)}|tests|docs|deploy)/[\w./\-]+)(#[\w\-]+)?")
GUIDES = {"docs/performance.md": 1800, "docs/language.md": 1800}
"""Pages for users, whose details are in the appendices `docs/performance/` and `docs/language/`."""
MADE = {"tests/data", "factory/run"}
"""Texts in the documents that look like paths but are not paths."""
FACES = ("minivla", "factory.dataset", "factory.gym", "schemas.bundle")
"""Packages and modules that users import. With the API reference, their public names need docstrings; elsewhere, a
function has one only if it says more than the signature."""
WHOLE = [ROOT / name.replace(".", "/") for name in FACES]
"""Packages of which every module is documented; of other packages, the API reference shows `__init__` only."""


def shown(path: Path) -> str:
    return str(path.relative_to(ROOT))


def cited_paths(page: Path) -> set[tuple[str, str]]:
    return {(path.rstrip("./"), anchor) for path, anchor in PATH.findall(page.read_text(encoding="utf-8"))}


@pytest.mark.parametrize("page", PAGES, ids=shown)
def test_every_link_points_to_an_existing_file_and_anchor(page: Path) -> None:
    broken = []
    for link in links_of(page):
        path, _, anchor = unquote(link).partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.is_relative_to(ROOT) or not target.exists() or (anchor and anchor not in anchors_of(target)):
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize(("name", "limit"), LIMITS.items())
def test_introductory_documents_are_short(name: str, limit: int) -> None:
    assert len((ROOT / name).read_text(encoding="utf-8").split()) <= limit


@pytest.mark.parametrize(("name", "limit"), GUIDES.items())
def test_guides_with_an_appendix_are_short(name: str, limit: int) -> None:
    assert len((ROOT / name).read_text(encoding="utf-8").split()) <= limit


def test_no_file_cites_a_document_outside_the_repository() -> None:
    here = {Path(__file__), Path(__file__).with_name("banned_phrases.toml")}
    found = [
        f"{shown(path)}: {hit.group()}"
        for path in CITING
        if path.is_file() and path not in here
        for hit in OTHERS.finditer(path.read_text(encoding="utf-8"))
    ]
    assert found == []


def test_every_named_markdown_file_exists() -> None:
    names = {page.name for page in PAGES}
    found = {
        f"{shown(path)}: {name}"
        for path in (*PAGES, *SOURCES)
        if path != HISTORY and not {"tests", "site"} & set(path.relative_to(ROOT).parts)
        for name in re.findall(r"([\w\-]+\.md)\b", path.read_text(encoding="utf-8"))
        if name not in names
    }
    assert found == set()


@pytest.mark.parametrize("page", [page for page in PAGES if page != HISTORY], ids=shown)
def test_every_path_in_a_document_exists(page: Path) -> None:
    gone = {path for path, _ in cited_paths(page) if not any(exists(path, page)) and path not in MADE}
    assert gone == set()


def exists(path: str, page: Path) -> list[bool]:
    return [(ROOT / path).exists(), (page.parent / path).exists()]


def test_every_document_that_a_source_file_cites_exists_with_its_section() -> None:
    broken, cited = set(), 0
    for source in SOURCES:
        for path, anchor in cited_paths(source):
            if not path.startswith("docs/") or "." not in Path(path).name:
                continue
            cited += 1
            target = ROOT / path
            if not target.exists() or (anchor and anchor[1:] not in anchors_of(target)):
                broken.add(f"{shown(source)}: {path}{anchor}")
    assert cited > 20
    assert broken == set()


def test_the_guarantees_name_tests_that_exist() -> None:
    text = (ROOT / "docs" / "design" / "guarantees.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:unit|integration|acceptance|contract|chaos)/[\w/.]+)`", text)
    assert len(named) > 20
    assert [name for name in named if not (ROOT / "tests" / name).exists()] == []


def test_the_architecture_names_packages_that_exist() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    table = text.partition("| package | purpose |")[2].partition("\n\n")[0]
    named = re.findall(
        r"`([a-z_.]+)`", "\n".join(line.split("|")[1] for line in table.splitlines() if line.count("|") > 2)
    )
    assert {name.partition(".")[0] for name in named} == set(PACKAGES)
    assert [name for name in named if not (ROOT / name.replace(".", "/") / "__init__.py").exists()] == []


def test_the_api_reference_names_modules_that_exist() -> None:
    text = (ROOT / "docs" / "site" / "hook.py").read_text(encoding="utf-8")
    named = re.findall(rf'"((?:{"|".join(PACKAGES)})(?:\.[a-z_]+)*)"', text)
    files = [ROOT / name.replace(".", "/") for name in named]
    assert "minivla" in named
    assert [str(file) for file in files if not (file.is_dir() or file.with_suffix(".py").exists())] == []


def faces() -> list[Path]:
    """Modules that users of the library import, and the modules of the API reference."""
    text = (ROOT / "docs" / "site" / "hook.py").read_text(encoding="utf-8")
    reference = re.findall(rf'"((?:{"|".join(PACKAGES)})(?:\.[a-z_]+)*)"', text)
    places = [ROOT / name.replace(".", "/") for name in (*FACES, *reference)]
    files = {module_of(place) for place in places}
    return sorted(files.union(*(place.rglob("*.py") for place in WHOLE)))


def module_of(place: Path) -> Path:
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")


@pytest.mark.parametrize("file", faces(), ids=shown)
def test_every_public_name_of_the_public_modules_is_documented(file: Path) -> None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
    silent = [
        node.name
        for body in (tree.body, *(each.body for each in classes))
        for node in body
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and not node.name.startswith("_")
        and ast.get_docstring(node) is None
    ]
    assert silent == []


def test_the_index_of_documents_reaches_every_document() -> None:
    reached, waiting = set(), [ROOT / "docs" / "README.md"]
    while waiting:
        page = waiting.pop()
        reached.add(page)
        targets = {(page.parent / link.partition("#")[0]).resolve() for link in links_of(page) if ".md" in link}
        waiting += sorted(targets - reached - set(waiting))
    assert set(PAGES) - reached == set()


def test_the_quickstart_notebook_was_executed_and_its_commands_are_valid() -> None:
    path = ROOT / "docs" / "quickstart.ipynb"
    text = path.read_text(encoding="utf-8")
    assert len(text) < 300_000
    assert re.findall(r"/(?:tmp|home|work|root)/", text) == []
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    commands = [line for cell in cells for line in "".join(cell["source"]).splitlines() if line.startswith("!factory ")]
    assert len(commands) >= 5
    for line in commands:
        parse_line(shlex.split(re.split(r" 2>| \|", line)[0])[1:])
    for cell in cells:
        assert cell["execution_count"] is not None
        assert cell["outputs"], cell["source"]
        assert [one for one in cell["outputs"] if one["output_type"] == "error"] == []


def test_every_decision_is_listed_in_the_index_and_cited_by_the_code() -> None:
    folder = ROOT / "docs" / "design"
    decisions = set()
    for note in folder.glob("*.md"):
        part = note.read_text(encoding="utf-8").partition("\n## Decisions\n")[2]
        titles = re.findall(r"^### (.*)$", part, re.MULTILINE)
        assert part.count("Rejected:") == len(titles), note.name
        decisions |= {f"{note.name}#{title.lower().replace(' ', '-')}" for title in titles}
    assert len(decisions) > 40
    listed = {link for link in links_of(folder / "README.md") if "#" in link}
    cited = {
        f"{path.removeprefix('docs/design/')}{anchor}"
        for source in SOURCES
        if source.suffix == ".py" and source.relative_to(ROOT).parts[0] in PACKAGES
        for path, anchor in cited_paths(source)
    }
    assert listed == decisions
    assert decisions - cited == set()


LINES = [
    pytest.param(words, id=f"{shown(page)}: {' '.join(words)}"[:90]) for page in PAGES for words in factory_lines(page)
]


@pytest.mark.parametrize("words", LINES)
def test_every_command_line_of_a_document_is_valid(words: list[str]) -> None:
    parse_line(words)


def test_every_make_target_that_a_document_names_exists() -> None:
    targets = set(re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    named = {target for page in PAGES if page != HISTORY for target in make_lines(page)}
    assert {"setup", "test"} <= named <= targets
