"""Builds a minimal catalog: scene descriptions without geometry, for plan expansion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from coordinator.expansion.catalog import Catalog, SceneEntry
from schemas.plan import Plan
from schemas.scene import Instance, SceneInfo, Target
from schemas.terms import Tier

ALL_TIERS = tuple(Tier)


def make_target(
    category: str, number: int, instance_id: int, colour: str = "red", tiers: Sequence[Tier] = ALL_TIERS
) -> Target:
    return Target(
        target_id=f"{category}_{number:03d}",
        category=category,
        instance_id=instance_id,
        prim_path=f"/World/{category}_{number}",
        centroid_m=(float(instance_id), 0.0, 0.5),
        size_m=(0.5, 0.5, 1.0),
        colour=colour,
        straight_tiers=tuple(tiers),
        connected_tiers=tuple(tiers),
        footprint_m=((0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.5)),
        surface_straight_tiers=tuple(tiers),
        surface_connected_tiers=tuple(tiers),
    )


def make_entry(name: str, targets: Sequence[Target]) -> SceneEntry:
    info = SceneInfo(
        name=name,
        source="test",
        source_sha256="0" * 64,
        metres_per_unit=1.0,
        bounds_m=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        grid_origin_m=(0.0, 0.0),
        targets=tuple(targets),
        instances=tuple(Instance(id=t.instance_id, prim_path=t.prim_path, category=t.category) for t in targets),
    )
    return SceneEntry(info, f"{abs(hash(name)) % 10:x}" * 64, 1000, Path(f"{name}.scene.zip"))


def make_catalog(plan: Plan, per_category: int = 5, colour: str = "red") -> Catalog:
    """Returns every scene of the plan with `per_category` targets of each category, reachable from every tier."""
    entries = {}
    for scene in plan.parts:
        seen, held_out = scene.categories
        names = [(category, n) for category in (*seen, *held_out) for n in range(per_category)]
        targets = [make_target(category, n, i, colour) for i, (category, n) in enumerate(names, 1)]
        entries[scene.name] = make_entry(scene.name, targets)
    return entries
