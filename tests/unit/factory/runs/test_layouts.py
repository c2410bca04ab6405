"""A layout takes the first of its seeds whose package fulfils the plan; packages are read from the cache."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.expansion.catalog import read_entry
from factory.dataset.packages import packages_by_scene
from factory.runs.catalog import collect_scenes, find_built, open_catalog
from factory.runs.layouts import BuiltLayout, LayoutBuilds, find_layouts
from factory.scenes.build import package_path
from schemas.errors import InvalidPlan
from schemas.plan import Plan
from schemas.scene import encode_scene
from tests.builders.scene import Box, build_scene, room_walls

PLAN = Plan.model_validate(
    {
        "name": "x",
        "scenes": [{"name": "office", "layouts": 2, "episodes": 4, "seed": 5, "seen": ["chair"], "held_out": ["rack"]}],
        "splits": {"train_id": 1},
        "tiers": {"near": 1},
        "task": {"success": "centroid"},
    }
)


def put_package(cache: Path, layout: str, seed: int, category: str) -> Path:
    """Writes the package of a layout for one seed to the cache: a room with one object."""
    box = Box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6), category=category)
    scene = build_scene((*room_walls((-4.0, -3.0), (4.0, 3.0)), box), name=layout)
    path = package_path("office", seed, cache, called=layout)
    path.write_bytes(encode_scene(scene, level=1))
    return path


def test_a_seed_without_a_valid_layout_is_followed_by_the_next_one(tmp_path: Path) -> None:
    good = put_package(tmp_path, "office_00005", 5, "chair")
    put_package(tmp_path, "office_00006", 6, "plant")
    third = put_package(tmp_path, "office_00006", 8, "chair")  # seed 7 belongs to office_00005
    built: list[BuiltLayout] = []
    catalog = open_catalog(
        PLAN, tmp_path / "data", tmp_path, builds=LayoutBuilds(tell=lambda one, _total: built.append(one))
    )
    assert {name: entry.path for name, entry in catalog.items()} == {"office_00005": good, "office_00006": third}
    assert catalog["office_00005"].known is None
    assert [len(one.refused) for one in built] == [0, 1]
    assert "seed 6: no reachable 'chair'" in built[1].refused[0]


def test_the_error_of_a_layout_that_no_seed_provides_names_the_reasons(tmp_path: Path) -> None:
    for seed in range(5, 45, 2):
        put_package(tmp_path, "office_00005", seed, "plant")
    with pytest.raises(InvalidPlan, match="none of 20 seeds of office_00005") as error:
        open_catalog(PLAN, tmp_path / "data", tmp_path)
    assert len(error.value.findings) == 20
    assert "seed 43: no reachable 'chair'" in error.value.findings[-1]


def test_a_category_that_a_family_never_has_is_refused_before_a_layout_is_built(tmp_path: Path) -> None:
    data = PLAN.model_dump(mode="json")
    data["scenes"][0] |= {"name": "home", "seen": ["bed", "whiteboard"], "held_out": ["vase"]}
    with pytest.raises(InvalidPlan, match="names categories that its families do not have") as error:
        collect_scenes(Plan.model_validate(data), tmp_path / "data", tmp_path / "cache")
    (finding,) = error.value.findings
    assert finding.startswith("scenes[0] home: no layout has whiteboard; remove them")
    assert not (tmp_path / "cache").exists()


def test_a_dataset_keeps_the_layouts_that_it_has(tmp_path: Path) -> None:
    scenes = tmp_path / "data" / "scenes"
    scenes.mkdir(parents=True)
    for name, seed in (("office_00005", 7), ("office_00006", 6)):
        path = put_package(tmp_path, name, seed, "chair")
        path.rename(scenes / f"{name}-{read_entry(path).sha256[:16]}.scene.zip")
    found = collect_scenes(PLAN, tmp_path / "data", tmp_path / "empty")
    assert {entry.path for entry in found.values()} == set(packages_by_scene(scenes).values())


def test_a_stopped_build_raises_keyboard_interrupt(tmp_path: Path) -> None:
    builds = LayoutBuilds()
    builds.stop.set()
    with pytest.raises(KeyboardInterrupt):
        collect_scenes(PLAN, tmp_path / "data", tmp_path, builds=builds)


def test_the_layouts_that_a_run_would_use_are_found_without_a_build(tmp_path: Path) -> None:
    good = put_package(tmp_path, "office_00005", 5, "chair")
    put_package(tmp_path, "office_00006", 6, "plant")  # refused, and its next seed is not built
    assert find_layouts(PLAN, tmp_path) == {"office_00005": good}
    assert find_built(PLAN, tmp_path).keys() == {"office_00005"}
    third = put_package(tmp_path, "office_00006", 8, "chair")
    assert find_layouts(PLAN, tmp_path) == {"office_00005": good, "office_00006": third}
