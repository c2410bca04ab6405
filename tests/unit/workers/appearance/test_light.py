"""Light groups and mixed light."""

from __future__ import annotations

import io

import numpy as np
import pytest

from schemas.appearance import LampLight, LightMix
from schemas.appearance.factors import DrawnAppearance
from schemas.appearance.light_groups import SCREENS, decode_light_groups, encode_light_groups
from schemas.errors import InvalidBundle, WorldError
from tests.builders.lit import lit_room, room_light
from workers.appearance.apply import apply_appearance
from workers.appearance.relight import LAMP_K, SKY_K, expose, gain_of, mix_light


def mix(*gains: float, kelvin: float = LAMP_K, sky: float = 1.0, adaptation: float = 0.0) -> LightMix:
    # the last group contains the narrow sides of the lamps
    lamps = tuple(LampLight(gain=gain, temperature_k=kelvin) for gain in (*gains, 1.0))
    return LightMix(lamps=lamps, sky=LampLight(gain=sky, temperature_k=SKY_K), adaptation=adaptation)


def test_lamps_are_grouped_by_place_and_windows_are_a_separate_group() -> None:
    groups = room_light().info.groups
    assert [group.kind for group in groups] == ["lamps", "lamps", "windows", SCREENS]
    assert groups[0].centre_m[0] == pytest.approx(-2.0, abs=0.1)
    assert groups[1].centre_m[0] == pytest.approx(2.0, abs=0.1)


def test_the_neutral_mix_is_the_baked_light_map_bit_for_bit() -> None:
    light_map = lit_room().light_map
    assert np.array_equal(mix_light(light_map, room_light().shares, mix(1.0, 1.0, 1.0, adaptation=0.7)), light_map)
    every = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    assert np.array_equal(expose(every, 0.0), every)


def test_a_lamp_that_is_off_darkens_its_half_of_the_room_most() -> None:
    room = lit_room()
    off = mix_light(room.light_map, room_light().shares, mix(0.0, 1.0, 1.0))
    floor = room.positions[:36].reshape(-1, 3, 3)
    top = int(np.flatnonzero((floor[..., 2] == 0.0).all(axis=1))[0])
    uv, xy = room.light_uvs[3 * top : 3 * top + 3].astype(float), floor[top, :, :2].astype(float)
    affine = np.linalg.solve(np.column_stack((xy, np.ones(3))), uv)

    def change(x: float) -> float:
        rows, columns = room.light_map.shape[:2]
        column, row = (np.array((x, 0.0, 1.0)) @ affine * (columns, rows)).astype(int)
        return float(off[row, column].mean()) / float(room.light_map[row, column].mean())

    assert change(-2.0) < 0.8
    assert change(-2.0) + 0.1 < change(2.0) <= 1.0


def test_warm_lamps_are_redder_and_exposure_brightens_all() -> None:
    room, shares = lit_room().light_map, room_light().shares
    warm = mix_light(room, shares, mix(1.0, 1.0, 1.0, kelvin=2700.0)).astype(int)
    assert (warm[..., 0] - warm[..., 2]).mean() > (room[..., 0].astype(int) - room[..., 2]).mean() + 5
    assert (expose(room, 1.0) >= room).all()
    assert gain_of(LampLight(gain=2.0, temperature_k=LAMP_K), LAMP_K) == (2.0, 2.0, 2.0)


def test_adaptation_keeps_a_room_with_little_light_visible() -> None:
    room, shares = lit_room().light_map, room_light().shares
    dark, adapted = (mix_light(room, shares, mix(0.1, 0.1, 0.1, sky=0.1, adaptation=share)) for share in (0.0, 1.0))
    assert dark.mean() < 0.6 * room.mean()
    assert adapted.mean() == pytest.approx(room.mean(), rel=0.1)


def test_light_groups_are_read_back_from_their_file_and_shares_that_do_not_add_up_are_refused() -> None:
    light = room_light()
    data = encode_light_groups(light)
    found = decode_light_groups(io.BytesIO(data))
    assert found.info == light.info
    assert np.array_equal(found.shares, light.shares)
    assert (light.shares.sum(axis=0, dtype=int) == 255).all()
    broken = type(light)(light.info, light.shares // 2)
    with pytest.raises(InvalidBundle, match="do not add up to 255"):
        decode_light_groups(io.BytesIO(encode_light_groups(broken)))


def test_missing_light_groups_and_those_of_another_scene_have_an_error_with_the_remedy() -> None:
    drawn = DrawnAppearance(name="varied", episode=1, light=mix(1.0))
    with pytest.raises(WorldError, match=r"has no light groups.*run `factory scene light "):
        apply_appearance(lit_room(), None, drawn)
    with pytest.raises(
        WorldError, match=r"has 4 light groups, the appearance has 2: the appearance is of another scene"
    ):
        apply_appearance(lit_room(), room_light(), drawn)
