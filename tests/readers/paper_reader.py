"""Compares the paper's tree with the archived bundles, byte for byte, with zipfile, zstandard and pyarrow.

The `meta.json` of the tree lacks time and worker; the other values are compared.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/paper_reader.py DATASET PAPER

PAPER: DATASET as `factory export --to paper`.
"""

import json
import sys
import zipfile
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import zstandard
from result import named, print_row


def main() -> None:
    dataset, paper = Path(sys.argv[1]), Path(sys.argv[2])
    bundles = sorted((dataset / "episodes").glob("*.zip"))
    assert [bundle.stem for bundle in bundles] == sorted(path.name for path in (paper / "episodes").iterdir())
    files = [check_episode(bundle, paper / "episodes" / bundle.stem) for bundle in bundles]
    print_row(
        paper, f"zipfile, {named('zstandard')}", f"{sum(files)} files of {len(files)} episodes equal to the bundles"
    )
    print_row(paper, named("pyarrow"), check_tables(dataset, paper))


def check_episode(bundle: Path, folder: Path) -> int:
    """Compares every member of a bundle with its file: raw bytes, and decompressed bytes for depth."""
    with zipfile.ZipFile(bundle) as stored:
        expected = {name.removesuffix(".zst"): name for name in stored.namelist()}
        assert json.loads((folder / "origin.json").read_text())["episode"] == bundle.stem
        found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {"origin.json"}
        assert found == expected.keys(), f"{bundle.stem}: {sorted(found ^ expected.keys())[:5]}"
        for name, member in expected.items():
            data = stored.read(member)
            if member.endswith(".zst"):
                data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
            written = (folder / name).read_bytes()
            same = metadata_of(data) == json.loads(written) if name == "meta.json" else data == written
            assert same, f"{bundle.stem}: {name} differs"
    return len(expected)


def metadata_of(data: bytes) -> dict[str, Any]:
    """Returns the values of a `meta.json` without time and worker."""
    values: dict[str, Any] = json.loads(data)
    del values["provenance"]["created_at"], values["provenance"]["worker"]
    return values


def check_tables(dataset: Path, paper: Path) -> str:
    """Checks that the rows of the tree equal those of the dataset, with the published columns first."""
    ours, theirs = pq.read_table(paper / "metadata.parquet"), pq.read_table(dataset / "metadata.parquet")
    assert ours.equals(theirs.select(ours.column_names))
    assert ours.column_names[:3] == ["episode_id", "split", "scene"]
    return f"metadata.parquet: {ours.num_rows} rows, {ours.num_columns} columns equal to the dataset's"


if __name__ == "__main__":
    main()
