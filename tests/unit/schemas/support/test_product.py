"""The version of the product: a changed source gives another one, other files do not."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from schemas.support.product import product_version, source_digest

ROOT = Path(__file__).parents[4]


def test_the_version_has_release_and_source() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+\+[0-9a-f]{10}", product_version())
    assert product_version().endswith(source_digest(ROOT)[:10])


def test_a_changed_module_changes_the_digest_and_bytecode_does_not(tmp_path: Path) -> None:
    for name in ("schemas", "workers"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    first = source_digest(tmp_path)
    (tmp_path / "workers/__pycache__").mkdir()
    (tmp_path / "workers/__pycache__/x.pyc").write_bytes(b"1")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests/x.py").write_text("x = 1\n")
    assert source_digest(tmp_path) == first
    module = tmp_path / "workers/physics/bullet.py"
    module.write_text(module.read_text() + "# edited\n")
    second = source_digest(tmp_path)
    assert second != first
    module.rename(module.with_name("bullet2.py"))
    assert source_digest(tmp_path) not in {first, second}
