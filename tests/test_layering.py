"""Checks the directions of imports and the modules that may import foreign systems."""

from __future__ import annotations

import ast
import functools
import graphlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("schemas", "coordinator", "workers", "factory", "minivla")
ALLOWED = {
    "schemas": {"schemas"},
    "coordinator": {"schemas", "coordinator"},
    "workers": {"schemas", "workers"},
    "factory": {"schemas", "coordinator", "workers", "factory"},
    "minivla": {"schemas", "factory", "minivla"},
}
DOORS = {
    "pybullet": {"workers/physics/bullet.py"},
    "moderngl": {"workers/render/"},
    "zenoh": {
        "workers/client/link.py",
        "coordinator/protocol/node.py",
        "coordinator/protocol/router.py",
        "coordinator/protocol/zenoh_config.py",
        "coordinator/protocol/ask.py",
    },
    "sqlalchemy": {"coordinator/"},
    "pxr": {"factory/scenes/importer/", "factory/scenes/author/"},
    "prometheus_client": {"coordinator/status/pages.py"},
    "starlette": {"factory/web/"},
    "uvicorn": {"coordinator/status/server.py"},
    "cryptography": {"factory/keys/"},
    "pyseccomp": {"coordinator/validation/sandbox.py"},
    "huggingface_hub": {"factory/push/hub.py"},
    "av": {"factory/export/video.py", "factory/visualize/film.py"},
    "matplotlib": {"factory/report/drawing/canvas.py"},
    "jinja2": {"factory/html/"},
    "mcap": {"factory/export/mcap/exporter.py", "factory/export/origin.py"},
    "mcap_protobuf": {"factory/export/mcap/protobuf.py"},
    "google": {"factory/export/mcap/protobuf.py"},
    "trimesh": {"factory/export/vlnce/exporter.py", "factory/scenes/formats/meshes.py"},
    "collada": {"factory/scenes/formats/collada.py"},
    "defusedxml": {"factory/scenes/formats/xml_text.py"},
    "mujoco": {"factory/scenes/formats/mjcf.py"},
    "rosbags": {"factory/export/mcap/ros2_cdr.py"},
    "h5py": {"factory/export/origin.py", "factory/export/robomimic.py"},
    "google_crc32c": {"factory/export/tfrecord.py"},
    "rerun": {"factory/visualize/rerun.py"},
    "embreex": {"workers/geometry/rays.py"},
    "ray": {"factory/runs/ray_engine.py"},
    "obstore": {"schemas/storage/object_store.py"},
    "pyarrow": {"coordinator/tables/", "factory/", "schemas/encoding/table_digest.py", "schemas/storage/"},
}


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@functools.cache
def imports_of(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            modules = {name for name in inner if _is_module(name)}
            found |= modules or {node.module}
    return found


def _is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def sources() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_lower_layers(package):
    stray = {
        f"{path.relative_to(ROOT)} imports {name}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for name in imports_of(path)
        if name.split(".")[0] in PACKAGES and name.split(".")[0] not in ALLOWED[package]
    }
    assert not stray


@pytest.mark.parametrize("system", sorted(DOORS))
def test_each_foreign_system_is_imported_in_one_place(system):
    users = {str(path.relative_to(ROOT)) for path in sources() if system in {n.split(".")[0] for n in imports_of(path)}}
    stray = {user for user in users if not any(user.startswith(door) for door in DOORS[system])}
    assert not stray


def test_only_two_modules_define_how_a_with_block_ends():
    """`VideoWriter` closes differently after an error; every other context manager inherits `Closing`."""
    writers = {str(path.relative_to(ROOT)) for path in sources() if "def __exit__" in path.read_text()}
    assert writers == {"schemas/support/closing.py", "factory/export/video.py"}


def test_imports_between_modules_form_no_cycle():
    names = {module_name(path): path for path in sources()}
    graph = {
        name: {other for other in imports_of(path) if other in names and other != name} for name, path in names.items()
    }
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join((*trail[trail.index(name) :], name))
        if name not in done:
            for other in graph[name]:
                visit(other, (*trail, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_every_module_has_a_docstring():
    silent = [
        str(path.relative_to(ROOT))
        for path in sources()
        if path.read_text().strip() and ast.get_docstring(parsed(path)) is None
    ]
    assert not silent


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_of_a_package_form_no_cycle(package):
    graph: dict[str, set[str]] = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        own = _folder_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
        named = {_folder_of(name) for name in imports_of(path) if name.startswith(f"{package}.")}
        graph.setdefault(own, set()).update(named - {own})
    list(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError, which names the cycle


def _folder_of(name: str) -> str:
    """Returns the folder or file, directly below a package, that contains a module."""
    return ".".join(name.split(".")[:2])
