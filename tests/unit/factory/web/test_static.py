"""Files that browsers load: vendored code is unchanged, and no script names another server."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from factory.web import app

STATIC = Path(app.__file__).parent / "static"
VENDORED = {  # files of the package three 0.185.0 of the npm registry
    "three.LICENSE.txt": "8b378ebe60e2fe500158cb0ac71cb5e8b7d92953c2abcc63a0eb90499653b5bc",
    "three.core.min.js": "0e9dd2793e01d0d9eb4f2ab00b4ffcdd4488275ebebee5c31fa8d347bc29f0bf",
    "three.module.min.js": "86bcee248b64f44bcfc23c331ae74619061957d59cab040171dcb6fb5900beb6",
}


def test_vendored_files_are_those_of_the_released_package_with_its_licence():
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (STATIC / "vendor").iterdir()}
    assert found == VENDORED
    assert "MIT License" in (STATIC / "vendor" / "three.LICENSE.txt").read_text()


def test_scripts_import_existing_files_of_this_server_only():
    for script in STATIC.rglob("*.js"):
        text = script.read_text()
        for name in re.findall(r'(?:from|import\()\s*"([^"]+)"', text):
            assert (script.parent / name).is_file(), (script.name, name)
        if script.parent == STATIC:
            assert "//" not in re.sub(r"(^|\s)//.*", "", text), script.name
