"""Registry of props: model name -> builder and number of variants. A new prop needs one builder and one line here.

Names of targets follow common asset names, with their misspellings; all other names match no category rule.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.random import Generator

from factory.scenes.author.geometry import bounds
from factory.scenes.author.materials import PropPiece
from factory.scenes.author.props import (
    accessories,
    bathroom,
    bedroom,
    clinic,
    clutter,
    cupboards,
    kitchen,
    living,
    office,
    safety,
    school,
    seating,
    shop,
    storage,
    vehicles,
    wall,
)
from schemas.support.numpy_types import Floats

Builder = Callable[[int, Generator], list[PropPiece]]


@dataclass(frozen=True)
class CatalogueEntry:
    """Entry of the registry: builder and number of variants."""

    build: Builder
    variants: int


@dataclass(frozen=True)
class PropModel:
    """Built prop.

    Attributes:
        name: layer and prim name, such as SM_ChairOffice_A_02.
        pieces: meshes with materials, metres, origin on the floor.
        low: (3,) lowest corner, metres.
        high: (3,) highest corner, metres.
    """

    name: str
    pieces: tuple[PropPiece, ...]
    low: Floats
    high: Floats

    @cached_property
    def boxes(self) -> list[tuple[Floats, Floats]]:
        """Lowest and highest corner of each piece, metres."""
        return [(piece.mesh.points.min(axis=0), piece.mesh.points.max(axis=0)) for piece in self.pieces]


CATALOGUE: Mapping[str, CatalogueEntry] = MappingProxyType(
    {
        "SM_ChairOffice_A": CatalogueEntry(seating.task_chair, 5),
        "SM_ChairExecutive_B": CatalogueEntry(seating.executive_chair, 3),
        "SM_ChairVisitor_C": CatalogueEntry(seating.cantilever_chair, 5),
        "SM_ChairWood_D": CatalogueEntry(seating.wooden_chair, 3),
        "SM_ChairWaiting_E": CatalogueEntry(seating.waiting_chair, 5),
        "SM_Stool_F": CatalogueEntry(seating.stool, 4),
        "SM_Sofa_A": CatalogueEntry(seating.sofa, 6),
        "SM_TableDesk_A": CatalogueEntry(office.desk, 12),
        "SM_TableMeeting_B": CatalogueEntry(office.meeting_table, 4),
        "SM_TableRound_C": CatalogueEntry(office.round_table, 6),
        "SM_TableCoffee_D": CatalogueEntry(office.coffee_table, 4),
        "SM_Monitor_A": CatalogueEntry(office.monitor, 3),
        "SM_Plant_A": CatalogueEntry(office.plant, 12),
        "SM_TrashCan_A": CatalogueEntry(office.trash_can, 12),
        "SM_FireExtinguisher_02": CatalogueEntry(safety.fire_extinguisher, 3),
        "SM_Whiteboard_A": CatalogueEntry(safety.whiteboard, 3),
        "SM_RackPile_04": CatalogueEntry(storage.rack, 9),
        "SM_ShelfSteel_A": CatalogueEntry(storage.shelf, 8),
        "SM_BarelPlastic_A": CatalogueEntry(storage.barrel, 9),
        "SM_CratePlastic_A": CatalogueEntry(storage.plastic_crate, 12),
        "SM_CrateWood_B": CatalogueEntry(storage.pallet_crate, 6),
        "SM_TypingPad": CatalogueEntry(office.keys_pad, 1),
        "SM_Cabinet": CatalogueEntry(clutter.cabinet, 3),
        "SM_KitchenCounter": CatalogueEntry(clutter.kitchen_counter, 3),
        "SM_Fridge": CatalogueEntry(clutter.fridge, 1),
        "SM_CoatStand": CatalogueEntry(clutter.coat_stand, 3),
        "SM_FloorLamp": CatalogueEntry(clutter.floor_lamp, 1),
        "SM_WaterCooler": CatalogueEntry(clutter.drinks_cooler, 1),
        "SM_Printer": CatalogueEntry(clutter.printer, 1),
        "SM_Reception": CatalogueEntry(clutter.reception, 3),
        "SM_CardBoxPile": CatalogueEntry(clutter.carton_pile, 4),
        "SM_PalletPile": CatalogueEntry(clutter.pallet_pile, 4),
        "SM_PalletTruck": CatalogueEntry(clutter.pallet_truck, 3),
        "SM_Cone": CatalogueEntry(clutter.cone, 1),
        "SM_ImpactPost": CatalogueEntry(clutter.protection_post, 1),
        "SM_Workbench": CatalogueEntry(clutter.workbench, 1),
        "SM_ForkLift": CatalogueEntry(vehicles.fork_lift, 3),
        "SM_Bed": CatalogueEntry(clinic.bed, 6),
        "SM_Nightstand": CatalogueEntry(clinic.nightstand, 2),
        "SM_DripStand": CatalogueEntry(clinic.drip_stand, 1),
        "SM_Curtain": CatalogueEntry(clinic.curtain, 3),
        "SM_HeadPanel": CatalogueEntry(clinic.head_panel, 1),
        "SM_Trolley": CatalogueEntry(clinic.trolley, 3),
        "SM_WheelChair": CatalogueEntry(clinic.wheelchair, 2),
        "SM_WashUnit": CatalogueEntry(clinic.wash_unit, 1),
        "SM_Poster": CatalogueEntry(wall.poster, 9),
        "SM_SafetyNotice": CatalogueEntry(wall.safety_notice, 3),
        "SM_Sign": CatalogueEntry(wall.hanging_sign, 2),
        "SM_Television": CatalogueEntry(wall.wall_screen, 2),
        "SM_Clock": CatalogueEntry(wall.clock, 1),
        "SM_Window": CatalogueEntry(wall.window, 3),
        "SM_RollerGate": CatalogueEntry(wall.roller_door, 1),
        "SM_BedDouble": CatalogueEntry(bedroom.bed, 12),
        "SM_NightStand": CatalogueEntry(cupboards.nightstand, 4),
        "SM_Dresser": CatalogueEntry(cupboards.dresser, 4),
        "SM_Wardrobe": CatalogueEntry(cupboards.wardrobe, 4),
        "SM_Sideboard": CatalogueEntry(cupboards.sideboard, 4),
        "SM_TvUnit": CatalogueEntry(cupboards.media_bench, 4),
        "SM_Locker": CatalogueEntry(cupboards.locker, 4),
        "SM_ShelfBook_B": CatalogueEntry(cupboards.bookcase, 12),
        "SM_ChairLounge_G": CatalogueEntry(bedroom.armchair, 6),
        "SM_Ottoman": CatalogueEntry(bedroom.ottoman, 6),
        "SM_Bench": CatalogueEntry(bedroom.bench, 3),
        "SM_Basket": CatalogueEntry(bedroom.basket, 4),
        "SM_Suitcase": CatalogueEntry(bedroom.suitcase, 4),
        "SM_Backpack": CatalogueEntry(bedroom.backpack, 4),
        "SM_Drape": CatalogueEntry(bedroom.curtains, 6),
        "SM_LampFloor": CatalogueEntry(living.floor_lamp, 3),
        "SM_LampSmall": CatalogueEntry(living.table_lamp, 4),
        "SM_TelevisionFlat": CatalogueEntry(living.television, 6),
        "SM_Fireplace": CatalogueEntry(living.fireplace, 3),
        "SM_Piano": CatalogueEntry(living.piano, 4),
        "SM_Fan": CatalogueEntry(living.fan, 3),
        "SM_Radiator": CatalogueEntry(living.radiator, 3),
        "SM_ClockTall": CatalogueEntry(living.tall_clock, 3),
        "SM_Vase": CatalogueEntry(living.vase, 4),
        "SM_Mirror": CatalogueEntry(living.mirror, 3),
        "SM_TableDining_E": CatalogueEntry(living.dining_table, 4),
        "SM_PictureFrame": CatalogueEntry(wall.framed_picture, 14),
        "SM_WindowHome": CatalogueEntry(wall.home_window, 26),
        "SM_WindowBand": CatalogueEntry(wall.band_window, 26),
        "SM_WindowStrip": CatalogueEntry(wall.strip_window, 26),
        "SM_EntryDoor": CatalogueEntry(wall.entry_door, 39),
        "SM_ToyPile": CatalogueEntry(living.toy_pile, 5),
        "SM_KitchenUnit": CatalogueEntry(kitchen.base_unit, 8),
        "SM_KitchenWallUnit": CatalogueEntry(kitchen.wall_unit, 4),
        "SM_SplashTiles": CatalogueEntry(kitchen.splash_back, 4),
        "SM_SinkUnit": CatalogueEntry(kitchen.sink_unit, 4),
        "SM_Oven": CatalogueEntry(kitchen.oven, 3),
        "SM_Dishwasher": CatalogueEntry(kitchen.dishwasher, 3),
        "SM_Refrigerator": CatalogueEntry(kitchen.refrigerator, 4),
        "SM_Microwave": CatalogueEntry(kitchen.microwave, 3),
        "SM_CoffeeMachine": CatalogueEntry(kitchen.coffee_machine, 3),
        "SM_CounterIsland": CatalogueEntry(kitchen.island, 3),
        "SM_Toilet": CatalogueEntry(bathroom.toilet, 3),
        "SM_BathTub": CatalogueEntry(bathroom.bathtub, 3),
        "SM_WashBasin": CatalogueEntry(bathroom.basin, 3),
        "SM_WashingMachine": CatalogueEntry(bathroom.washing_machine, 3),
        "SM_TowelRail": CatalogueEntry(bathroom.towel_rail, 4),
        "SM_ShelfShop_C": CatalogueEntry(shop.gondola, 6),
        "SM_CounterCheckout": CatalogueEntry(shop.checkout, 3),
        "SM_FreezerUpright": CatalogueEntry(shop.freezer, 3),
        "SM_VendingMachine": CatalogueEntry(shop.vending_machine, 3),
        "SM_ClothesRail": CatalogueEntry(shop.clothes_rail, 3),
        "SM_Mannequin": CatalogueEntry(shop.mannequin, 3),
        "SM_Cart": CatalogueEntry(shop.shopping_cart, 3),
        "SM_ProduceStand": CatalogueEntry(shop.produce_stand, 3),
        "SM_StepLadder": CatalogueEntry(shop.step_ladder, 3),
        "SM_CartonSingle": CatalogueEntry(shop.moving_box, 3),
        "SM_OfferPlate": CatalogueEntry(shop.offer_sign, 3),
        "SM_TablePupil_F": CatalogueEntry(school.pupil_desk, 12),
        "SM_TableTeacher_G": CatalogueEntry(school.lectern, 3),
        "SM_Laptop": CatalogueEntry(school.laptop, 3),
        "SM_ComputerCase": CatalogueEntry(school.computer_case, 3),
        "SM_Copier": CatalogueEntry(school.copier, 3),
        "SM_Bicycle": CatalogueEntry(school.bicycle, 3),
        "SM_TrafficCone": CatalogueEntry(school.traffic_cone, 3),
        "SM_WaterDispenser": CatalogueEntry(school.water_dispenser, 3),
        "SM_ClockWall": CatalogueEntry(school.wall_clock, 3),
        "SM_WallMap": CatalogueEntry(school.wall_map, 3),
        "SM_BookPile": CatalogueEntry(accessories.book_pile, 12),
        "SM_BookRow": CatalogueEntry(accessories.book_row, 12),
        "SM_Crockery": CatalogueEntry(accessories.crockery, 6),
        "SM_Bouquet": CatalogueEntry(accessories.bouquet, 6),
        "SM_FruitBowl": CatalogueEntry(accessories.fruit_bowl, 12),
        "SM_Candles": CatalogueEntry(accessories.candles, 4),
        "SM_Tray": CatalogueEntry(accessories.tray, 3),
        "SM_Kettle": CatalogueEntry(accessories.kettle, 12),
        "SM_Papers": CatalogueEntry(accessories.papers, 8),
        "SM_Globe": CatalogueEntry(accessories.globe, 3),
        "SM_Portrait": CatalogueEntry(accessories.portrait, 6),
        "SM_Flasks": CatalogueEntry(accessories.flasks, 5),
        "SM_WallLedge": CatalogueEntry(accessories.wall_ledge, 12),
        "SM_CoatHooks": CatalogueEntry(accessories.coat_hooks, 6),
        "SM_Tapestry": CatalogueEntry(accessories.tapestry, 6),
        "SM_PinBoard": CatalogueEntry(accessories.pin_board, 3),
        "SM_CardFrieze": CatalogueEntry(accessories.card_frieze, 3),
        "SM_Pennants": CatalogueEntry(accessories.pennants, 6),
    }
)
"""Model name -> catalogue entry."""


class PropBuilder:
    """Cache of prop models of one scene. A model depends on (seed, name, variant) only."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._models: dict[str, PropModel] = {}

    def model(self, name: str, variant: int) -> PropModel:
        """Returns the model of a prop; `variant` is taken modulo the number of variants."""
        entry = CATALOGUE[name]
        index = variant % entry.variants
        full_name = f"{name}_{index:02d}"
        if full_name not in self._models:
            rng = np.random.default_rng([self._seed, zlib.crc32(full_name.encode())])
            pieces = tuple(entry.build(index, rng))
            low, high = bounds([piece.mesh for piece in pieces])
            self._models[full_name] = PropModel(full_name, pieces, low, high)
        return self._models[full_name]
