"""Appearances as files: built-in ones, and messages for mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.appearance import Appearance, LightMix
from schemas.appearance.appearance_file import find_appearance, load_appearance
from schemas.builtin import BUILTIN_APPEARANCES
from schemas.errors import InvalidAppearance, UsageError


@pytest.mark.parametrize("name", BUILTIN_APPEARANCES)
def test_built_in_appearances_vary_the_factors_that_they_name(name: str) -> None:
    found = load_appearance(name)
    varied = {factor for factor in ("light", "materials", "camera", "clutter") if getattr(found, factor) is not None}
    all_factors = {"light", "materials", "camera", "clutter"}
    assert varied == {"varied": all_factors - {"clutter"}, "full": all_factors}.get(name, {name})


def test_a_file_has_its_own_ranges_and_the_name_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "night.toml"
    path.write_text("[light]\nsky = [0.0, 0.2]\n")
    found = load_appearance(str(path))
    assert found.name == "night"
    assert found.light is not None
    assert found.light.sky == (0.0, 0.2)
    assert Appearance.model_validate(found.plain()) == found


@pytest.mark.parametrize("key", ["adaptation", "adaption"])
def test_both_spellings_of_adaptation_are_read_and_the_old_one_is_written(tmp_path: Path, key: str) -> None:
    path = tmp_path / "slow.toml"
    path.write_text(f"[light]\n{key} = 0.2\n")
    light = load_appearance(str(path)).light
    assert light is not None
    assert light.adaptation == 0.2
    assert '"adaption":0.2' in light.model_dump_json()
    mix = LightMix.model_validate({"lamps": (), "sky": {"gain": 1.0, "temperature_k": 6500.0}, key: 0.2})
    assert mix.model_dump_json().endswith('"adaption":0.2}')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[light]\nlamps = [1.5, 0.5]", "light.lamps: the first value, 1.5, must not be greater than the second, 0.5"),
        ("[light]\nlamps = [0.5, 20]", r"light.lamps\[1\]: Input should be less than or equal to 8"),
        ("[materials]\nwalls = ['paint', 'gold']", "materials.walls.*'paint', 'brick', 'concrete'"),
        ("[clutter]\nkinds = []", "clutter.kinds"),
        ("[weather]\nrain = 1", "weather: no such key"),
    ],
)
def test_mistakes_are_listed_with_their_keys(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(InvalidAppearance, match=message):
        load_appearance(str(path))


def test_the_error_of_an_unknown_name_suggests_the_closest_name() -> None:
    with pytest.raises(UsageError, match=r"no appearance .varid.: no such file; .*did you mean .varied."):
        load_appearance("varid")


def test_the_name_none_means_no_appearance() -> None:
    assert find_appearance("none") is None
