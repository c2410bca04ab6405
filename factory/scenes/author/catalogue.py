"""The registry of props: model name -> builder and how many variants it has. A new prop is one builder and one line.

Names of targets follow the assets of the field, misspellings included; all other names match no category rule.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.random import Generator

from factory.scenes.author import (
    props_clinic,
    props_clutter,
    props_office,
    props_safety,
    props_seating,
    props_storage,
    props_wall,
)
from factory.scenes.author.geometry import Floats, bounds
from factory.scenes.author.materials import Piece

__all__ = ["CATALOGUE", "Entry", "Model", "Workshop"]

Builder = Callable[[int, Generator], list[Piece]]


@dataclass(frozen=True)
class Entry:
    """One line of the registry: who builds it and how many variants exist."""

    build: Builder
    variants: int


@dataclass(frozen=True)
class Model:
    """A built prop.

    Attributes:
        name: layer and prim name, such as SM_ChairOffice_A_02.
        pieces: meshes with materials, metres, origin on the floor.
        low: (3,) lowest corner, metres.
        high: (3,) highest corner, metres.
    """

    name: str
    pieces: tuple[Piece, ...]
    low: Floats
    high: Floats


CATALOGUE: Mapping[str, Entry] = MappingProxyType(
    {
        "SM_ChairOffice_A": Entry(props_seating.task_chair, 5),
        "SM_ChairExecutive_B": Entry(props_seating.executive_chair, 3),
        "SM_ChairVisitor_C": Entry(props_seating.cantilever_chair, 5),
        "SM_ChairWood_D": Entry(props_seating.wooden_chair, 3),
        "SM_ChairWaiting_E": Entry(props_seating.waiting_chair, 5),
        "SM_Stool_F": Entry(props_seating.stool, 4),
        "SM_Sofa_A": Entry(props_seating.sofa, 6),
        "SM_TableDesk_A": Entry(props_office.desk, 12),
        "SM_TableMeeting_B": Entry(props_office.meeting_table, 4),
        "SM_TableRound_C": Entry(props_office.round_table, 6),
        "SM_TableCoffee_D": Entry(props_office.coffee_table, 4),
        "SM_Monitor_A": Entry(props_office.monitor, 3),
        "SM_Plant_A": Entry(props_office.plant, 12),
        "SM_TrashCan_A": Entry(props_office.trash_can, 12),
        "SM_FireExtinguisher_02": Entry(props_safety.fire_extinguisher, 3),
        "SM_Whiteboard_A": Entry(props_safety.whiteboard, 3),
        "SM_RackPile_04": Entry(props_storage.rack, 9),
        "SM_ShelfSteel_A": Entry(props_storage.shelf, 8),
        "SM_BarelPlastic_A": Entry(props_storage.barrel, 9),
        "SM_CratePlastic_A": Entry(props_storage.plastic_crate, 12),
        "SM_CrateWood_B": Entry(props_storage.pallet_crate, 6),
        "SM_TypingPad": Entry(props_office.keys_pad, 1),
        "SM_Cabinet": Entry(props_clutter.cabinet, 3),
        "SM_KitchenCounter": Entry(props_clutter.kitchen_counter, 3),
        "SM_Fridge": Entry(props_clutter.fridge, 1),
        "SM_CoatStand": Entry(props_clutter.coat_stand, 3),
        "SM_FloorLamp": Entry(props_clutter.floor_lamp, 1),
        "SM_WaterCooler": Entry(props_clutter.drinks_cooler, 1),
        "SM_Printer": Entry(props_clutter.printer, 1),
        "SM_Reception": Entry(props_clutter.reception, 3),
        "SM_CardBoxPile": Entry(props_clutter.carton_pile, 4),
        "SM_PalletPile": Entry(props_clutter.pallet_pile, 4),
        "SM_PalletTruck": Entry(props_clutter.pallet_truck, 3),
        "SM_Cone": Entry(props_clutter.cone, 1),
        "SM_ImpactPost": Entry(props_clutter.protection_post, 1),
        "SM_Workbench": Entry(props_clutter.workbench, 1),
        "SM_Bed": Entry(props_clinic.bed, 6),
        "SM_Nightstand": Entry(props_clinic.nightstand, 2),
        "SM_DripStand": Entry(props_clinic.drip_stand, 1),
        "SM_Curtain": Entry(props_clinic.curtain, 3),
        "SM_HeadPanel": Entry(props_clinic.head_panel, 1),
        "SM_Trolley": Entry(props_clinic.trolley, 3),
        "SM_WheelChair": Entry(props_clinic.wheelchair, 2),
        "SM_WashUnit": Entry(props_clinic.wash_unit, 1),
        "SM_Poster": Entry(props_wall.poster, 9),
        "SM_SafetyNotice": Entry(props_wall.safety_notice, 3),
        "SM_Sign": Entry(props_wall.hanging_sign, 2),
        "SM_Television": Entry(props_wall.wall_screen, 2),
        "SM_Clock": Entry(props_wall.clock, 1),
        "SM_Window": Entry(props_wall.window, 3),
        "SM_RollerGate": Entry(props_wall.roller_door, 1),
    }
)
"""Every prop by model name."""


class Workshop:
    """Builds each model once per scene; what it builds depends on (seed, name, variant) alone."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._models: dict[str, Model] = {}

    def model(self, name: str, variant: int) -> Model:
        """The model of a prop; `variant` wraps around the number of variants."""
        entry = CATALOGUE[name]
        index = variant % entry.variants
        full_name = f"{name}_{index:02d}"
        if full_name not in self._models:
            rng = np.random.default_rng([self._seed, zlib.crc32(full_name.encode())])
            pieces = tuple(entry.build(index, rng))
            low, high = bounds([piece.mesh for piece in pieces])
            self._models[full_name] = Model(full_name, pieces, low, high)
        return self._models[full_name]
