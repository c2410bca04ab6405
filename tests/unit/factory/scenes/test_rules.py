"""Category rules on names of public assets."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.scenes.rules import BUILTIN_RULES, builtin_rules, load_rules, split_name
from schemas.errors import UsageError
from schemas.terms import CATEGORIES

RULES = builtin_rules()


@pytest.mark.parametrize(
    ("name", "category"),
    [
        ("SM_ChairOffice_A_184", "chair"),
        ("SM_BarelPlastic_A_01_9", "barrel"),
        ("SM_Board", "whiteboard"),
        ("SM_Extinguisher", "fire_extinguisher"),
        ("SM_RackPile_04", "rack"),
        ("SM_RackShelf_01", "shelf"),
        ("aws_robomaker_warehouse_ShelfF_01_001", "shelf"),
        ("trashcan_03", "trash_can"),
        ("SM_CratePlastic_A_04", "crate"),
        ("SM_TableRound_C", "table"),
        ("FicusPlant12", "plant"),
        ("SM_Sofa", "sofa"),
        ("ComputerMonitor", "monitor"),
        ("FlatScreenTV_02", "television"),
        ("TV_Stand", "cabinet"),
        ("aws_robomaker_residential_Bed_01", "bed"),
        ("SM_CardBoxA_01", "box"),
        ("cardboard_box", "box"),
        ("KitchenCabinet_01_001", "cabinet"),
        ("PalletJackB_01", "pallet_jack"),
        ("fridges", "refrigerator"),
        ("Storage0", "cabinet"),
        ("storage_unit_12", "cabinet"),
        ("WasherDryer1", "washing_machine"),
        ("table_top", "table"),
    ],
)
def test_names_of_public_assets_match_their_category(name: str, category: str) -> None:
    rule = RULES.match(name)
    assert rule is not None
    assert rule.category == category


@pytest.mark.parametrize(
    "name",
    [
        "SM_WheelChair_01a",
        "SM_TabletPC",
        "SM_PaperTablet",
        "KeyBoard",
        "Bedroom",
        "EmbeddedPanel",
        "TrackLight",
        "WallBracket",
        "BloodPressureMonitor",
        "SM_Rackshield",
        "SM_BoxPortableA",
        "Staircase",
        "CookingBench_01",
        "cupboardLeftBoard",
        "test_bench",
        "StorageRoom",
        "TableLeg_01",
        "chair_cushion_2b",
        "SofaPillow",
        "TennisRacket",
        "eggplant",
        "kitchen_island_left_panel",
        "suitable_place",
        "Wall",
    ],
)
def test_similar_names_match_no_category(name: str) -> None:
    assert RULES.match(name) is None


def test_the_builtin_rules_cover_the_papers_categories() -> None:
    assert {rule.category for rule in RULES.rules} >= set(CATEGORIES)
    assert {rule.category for rule in RULES.only(CATEGORIES).rules} == set(CATEGORIES)


HM3D_GOALS = ("chair", "sofa", "potted_plant", "bed", "toilet", "tv_monitor")
COCO_INDOORS = """
    bench backpack suitcase chair couch potted_plant bed dining_table toilet tv laptop microwave oven sink refrigerator
    clock vase bicycle
"""
ADE20K_INDOORS = """
    bed cabinet table plant sofa shelf mirror armchair desk wardrobe lamp bathtub chest_of_drawers counter sink
    fireplace refrigerator bookcase toilet stove computer swivel_chair ottoman washer dishwasher fan clock
    radiator basket bicycle painting television_receiver
"""


@pytest.mark.parametrize("name", sorted({*HM3D_GOALS, *COCO_INDOORS.split(), *ADE20K_INDOORS.split()}))
def test_indoor_objects_of_the_usual_datasets_have_a_category(name: str) -> None:
    assert RULES.match(name) is not None


def test_a_name_can_match_rules_for_objects_of_different_shapes() -> None:
    assert [rule.category for rule in RULES.matches("BedsideTable")] == ["nightstand", "table"]


def test_the_last_thing_of_a_name_decides() -> None:
    names = {"sink_area_dish_washer_main": "dishwasher", "kitchen_island_stove": "oven", "desk_chair": "chair"}
    assert {name: next(RULES.matches(name)).category for name in names} == names
    assert [rule.category for rule in RULES.matches("sink_area_dish_washer")][-1] == "sink"


def test_words_are_split_at_case_digits_and_punctuation() -> None:
    assert split_name("SM_BarelPlastic-A01") == "sm_barel_plastic_a_01"


@pytest.mark.parametrize(
    "text",
    [
        "- category: chair\n  include: ['(']",
        "chair",
        ": :\n-",
        "- category: chair\n  include: [a]\n  include: [b]",
        "- category: chair",
        "- category: chair\n  include: [a]\n  colours: [beige]",
    ],
)
def test_the_error_of_an_invalid_rule_table_names_its_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"mine\.yaml"):
        load_rules(path)


def test_a_missing_rule_table_is_refused_with_the_command_that_creates_one(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=f"cannot read category rules.*`cp {BUILTIN_RULES} {tmp_path}/absent.yaml`"
    ) as caught:
        load_rules(tmp_path / "absent.yaml")
    assert "Errno" not in str(caught.value)


def test_racks_shelves_and_monitors_are_not_named_by_the_colour_of_their_content() -> None:
    assert builtin_rules().only(CATEGORIES).uncoloured == {"rack", "shelf", "monitor"}


@pytest.mark.parametrize("name", ["cupboardLeftBoard", "Cabinet_Back_Board", "shelfBoard02", "wardrobe_board"])
def test_a_board_of_furniture_is_no_whiteboard(name: str) -> None:
    assert "whiteboard" not in [rule.category for rule in RULES.matches(name)]
