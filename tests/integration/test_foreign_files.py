"""External files that break parsers: each raises an error of the product that names the file."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from coordinator.expansion.plan_file import load_plan
from coordinator.tables.table_reader import read_column, read_failed_attempts
from factory.cli.main import _run
from factory.dataset.reader import Dataset
from factory.eval.models.spec import read_specs
from factory.scenes.rules import load_rules
from factory.scenes.targets.target_list import load_target_list
from factory.scenes.yaml_text import read_yaml
from schemas.dataset.meta import read_dataset_meta
from schemas.encoding.ndarray import decode_npy
from schemas.errors import ArchiveCorrupt, InvalidBundle, UsageError
from schemas.storage.place import place_of
from tests.builders.dataset import make_dataset

DEEP = 100_000
TOML = {
    "nested too deeply": "x = " + "[" * DEEP,
    "tables nested too deeply": "[" + ".".join("a" for _ in range(DEEP)) + "]",
    "not UTF-8": b"name = '\xff\xfe'",
    "a huge number": "seed = " + "9" * 5000,
    "too large": "#" * (5 << 20),
    "a NUL in a path": 'name = "a"\n[[scenes]]\nname = "s"\nepisodes = 1\nusd = "a\\u0000b.usda"\nseen = ["chair"]',
    "a path too long": f'name = "a"\n[[scenes]]\nname = "s"\nepisodes = 1\nusd = "{"a" * 300}.usda"\nseen = ["chair"]',
}
YAML = {
    "nested too deeply": "[" * DEEP,
    "a bomb of aliases": "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]",
    "an impossible date": "2026-99-99",
    "too large": "#" * (5 << 20),
    "a NUL": "a: \0",
    "invalid binary": "!!binary '\u00e4'",
}


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("kind", list(TOML))
def test_an_unparsable_plan_is_refused_by_name(tmp_path, kind):
    with pytest.raises(UsageError):
        load_plan(str(write(tmp_path / "plan.toml", TOML[kind])))


@pytest.mark.parametrize("kind", list(YAML))
def test_unparsable_yaml_is_refused(tmp_path, kind):
    with pytest.raises(yaml.YAMLError):
        read_yaml(YAML[kind])
    path = write(tmp_path / "list.yaml", YAML[kind])
    with pytest.raises(UsageError, match=r"list\.yaml"):
        load_rules(path)
    with pytest.raises(UsageError, match=r"list\.yaml"):
        load_target_list(path, "lab")


@pytest.mark.parametrize("name", ["a" * 300, "x/" * 3000, "a\0b"])
def test_an_impossible_path_is_a_usage_error(name):
    with pytest.raises(UsageError, match=r"NUL|bytes"):
        place_of(name)
    with pytest.raises(UsageError, match=r"NUL|bytes"):
        load_plan(name)


@pytest.mark.parametrize(
    "words",
    [("verify",), ("stats",), ("status",), ("show",), ("plan", "show"), ("scene", "inspect"), ("scene", "import")],
)
def test_an_overlong_path_is_a_usage_error_for_every_command(monkeypatch, capsys, words):
    more = {"show": ("1", "-o", "x.png"), "scene import": ("--name", "lab")}.get(" ".join(words), ())
    monkeypatch.setattr(sys, "argv", ["factory", *words, "a" * 300, *more])
    assert _run() in (1, 2)
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("header", ["(((", "{'descr': " + "[" * 90, "\\", "{'descr': '<f4', 'shape': (1e999,)}", "'''"])
def test_an_unparsable_array_header_is_an_invalid_bundle(header):
    text = header.encode().ljust(117) + b"\n"
    data = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
    with pytest.raises(InvalidBundle, match="array"):
        decode_npy("poses.npy", data, np.float32, (None, 7))


def test_invalid_utf8_in_a_table_is_reported_as_damage(tmp_path):
    make_dataset(tmp_path / "out")
    path = tmp_path / "out" / "metadata.parquet"
    table = pq.read_table(path)
    bad = pa.array([b"\xff\xfe"] * table.num_rows, pa.binary()).view(pa.string())
    strange = table.set_column(table.schema.get_field_index("instruction"), "instruction", bad)
    pq.write_table(strange, path)
    for read in (lambda data: data[0], lambda data: data["ep_000001"], lambda data: data.metadata):
        with pytest.raises(ArchiveCorrupt, match=r"metadata.parquet is damaged"):  # columns are read on demand
            read(Dataset(tmp_path / "out"))
    assert isinstance(read_column(path, "instruction"), str)
    attempts = tmp_path / "attempts.parquet"
    pq.write_table(pa.table({"detail": bad}), attempts)
    assert read_failed_attempts(attempts) == []


@pytest.mark.parametrize("text", ["[" * DEEP, '{"format": ' + "9" * 5000 + "}", '"' + "\\ud800" + '"'])
def test_unparsable_json_is_reported_as_damage(tmp_path, text):
    write(tmp_path / "dataset_meta.json", text)
    with pytest.raises(ArchiveCorrupt):
        read_dataset_meta(tmp_path)
    with pytest.raises(UsageError, match=r"specs.json"):
        read_specs(write(tmp_path / "specs.json", text))


def test_a_valid_file_is_read(tmp_path):
    assert load_plan("demo").episodes == 16
    assert read_yaml(json.dumps({"a": [1, "b"]})) == {"a": [1, "b"]}
    make_dataset(tmp_path / "out")
    assert len(Dataset(tmp_path / "out")) == 3
