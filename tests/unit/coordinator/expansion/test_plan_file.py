"""Plan files: every error names its key; reducing the size keeps proportions."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from coordinator.expansion.builtin import BUILTIN_PLANS, is_paper_plan
from coordinator.expansion.plan_file import load_plan, parse_plan, plan_to_toml, scenes_named, shrink
from coordinator.ledger.opening import plan_differences, require_plan
from factory.runs.plan_keys import STARTER, keys_as_markdown, list_keys
from schemas.config import DemonstrationConfig
from schemas.errors import InvalidPlan, UsageError
from schemas.plan import Plan, ScenePlan
from schemas.terms import Recording, Split, SuccessMeasure, Tier

GOOD = """
name = "mine"
seed = 7
[tiers]
near = 0.5
mid = 0.5
[[scenes]]
name = "office"
episodes = 12
[[scenes]]
name = "my_lab"
usd = "lab/world.usda"
seen = ["chair"]
held_out = ["plant"]
episodes = 3
"""


def test_a_valid_file_is_read_and_scene_paths_are_relative_to_it(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    plan = load_plan(str(path))
    assert plan.tiers == {Tier.NEAR: 0.5, Tier.MID: 0.5}
    assert plan.scenes[1].file == str(tmp_path / "lab/world.usda")
    assert plan.episodes == 15


def test_the_error_of_an_unknown_plan_lists_the_built_in_plans():
    with pytest.raises(UsageError, match="demo, paper, balanced, referring; did you mean 'paper'"):
        load_plan("papper")


@pytest.mark.parametrize(
    ("reference", "said"),
    [
        (
            "mine.toml",
            r"no plan 'mine.toml': no such file \(the built-in plans are demo, .*, referring\)$",
        ),
        ("plans/mine", "no plan 'plans/mine': no such file"),
        ("demo.toml", "no such file .*; did you mean 'demo'"),
        ("/", "that is a directory; give a TOML file"),
    ],
)
def test_a_missing_file_is_reported(reference, said):
    with pytest.raises(UsageError, match=said):
        load_plan(reference)


def test_an_unknown_scene_suggests_the_closest_scene_of_the_plan():
    with pytest.raises(UsageError, match=r"has no scene 'hospitl'; its scenes: .*; did you mean 'hospital'"):
        shrink(load_plan("demo"), scenes=["hospitl"])


def test_every_mistake_is_named_with_its_key(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(
        'name = "bad"\nexpert = "wizard"\nspeed = 3\n[tiers]\nnear = 0.5\nnar = 0.5\n'
        '[[scenes]]\nname = "offce"\nepisodes = 0\n[[scenes]]\nname = "office"\nepisodes = 2\nseen = ["cat"]\n'
    )
    with pytest.raises(InvalidPlan) as caught:
        load_plan(str(path))
    text = "\n".join(caught.value.findings)
    for key in ("scenes[0].name", "scenes[0].episodes", "scenes[1].seen", "expert", "speed", "tiers.nar"):
        assert f"{key}:" in text


def test_shares_that_do_not_add_up_are_each_named(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text('[tiers]\nnear = 0.5\n[splits]\ntrain_id = 0.7\n[[scenes]]\nname = "office"\nepisodes = 2\n')
    with pytest.raises(InvalidPlan) as caught:
        load_plan(str(path))
    assert [text.split(":")[0] for text in caught.value.findings] == ["tiers", "splits"]


def test_the_error_of_an_unknown_screening_lists_the_valid_screenings(tmp_path):
    path = tmp_path / "p.toml"
    path.write_text('[spawn]\nscreening = "blind"\n[[scenes]]\nname = "office"\nepisodes = 3\n')
    with pytest.raises(InvalidPlan, match=r"spawn\.screening.*'none', 'sight', 'free_line' or 'foreseen'.*'blind'"):
        load_plan(str(path))


def test_screening_free_drive_is_another_spelling_of_foreseen(tmp_path):
    texts = (
        '[spawn]\nscreening = "free_drive"\n[[scenes]]\nname = "office"\nepisodes = 3\nscreening = "free_drive"\n',
    )
    texts += (texts[0].replace("free_drive", "foreseen"),)
    (tmp_path / "p.toml").write_text(texts[0])
    new = load_plan(str(tmp_path / "p.toml"))
    (tmp_path / "p.toml").write_text(texts[1])
    assert new == load_plan(str(tmp_path / "p.toml"))
    assert "free_drive" not in new.model_dump_json()


def test_an_unknown_split_is_named(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text('[splits]\ntrain = 1.0\n[[scenes]]\nname = "office"\nepisodes = 2\n')
    with pytest.raises(InvalidPlan, match=r"splits\.train"):
        load_plan(str(path))


def test_the_error_of_an_unknown_uniqueness_or_balance_lists_the_valid_values(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text('balance = "even"\n[instructions]\nunique = "always"\n[[scenes]]\nname = "office"\nepisodes = 2\n')
    with pytest.raises(InvalidPlan) as caught:
        load_plan(str(path))
    text = "\n".join(caught.value.findings)
    assert "instructions.unique: Input should be 'scene', 'view' or 'off' (found 'always', line 3)" in text
    assert "balance: Input should be 'instances', 'categories' or 'categories_overall' (found 'even', line 1)" in text


def test_invalid_toml_is_reported(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("name = [")
    with pytest.raises(InvalidPlan, match="is not valid TOML"):
        load_plan(str(path))


def test_the_error_of_a_scene_file_given_as_a_plan_names_the_expected_format(tmp_path):
    path = tmp_path / "shop.glb"
    path.write_bytes(b"glTF\x02\0\0\0\xff\xfe")
    with pytest.raises(InvalidPlan, match="is not a plan; plans are TOML files"):
        load_plan(str(path))


def test_shrinking_keeps_the_proportions_of_the_scenes():
    plan = shrink(BUILTIN_PLANS["paper"], episodes=117)
    assert plan.episodes == 117
    assert {scene.name: scene.episodes for scene in plan.scenes} == {
        "office": 70,
        "hospital": 5,
        "full_warehouse": 35,
        "warehouse_multiple_shelves": 7,
    }


def test_the_error_of_shrinking_to_an_unknown_scene_names_the_scenes_of_the_plan():
    with pytest.raises(UsageError, match="office, hospital"):
        shrink(BUILTIN_PLANS["demo"], scenes=["garage"])


def test_equivalent_plans_have_one_digest():
    demo = BUILTIN_PLANS["demo"]
    assert demo.digest == shrink(demo, episodes=demo.episodes).digest
    assert demo.digest != shrink(demo, seed=1).digest


def test_a_recording_of_frames_keeps_the_former_digest_and_a_recording_of_states_has_another_digest(tmp_path):
    demo = BUILTIN_PLANS["demo"]
    assert "record" not in demo.model_dump()
    states = shrink(demo, record=Recording.STATES)
    assert states.digest != demo.digest
    assert shrink(states, record=Recording.FRAMES).digest == demo.digest
    path = tmp_path / "mine.toml"
    path.write_text(plan_to_toml(states))
    assert load_plan(str(path)).record is Recording.STATES


def test_the_error_of_an_unknown_recording_lists_the_valid_recordings(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('record = "video"\n' + GOOD)
    with pytest.raises(InvalidPlan, match="record: Input should be 'frames' or 'states'"):
        load_plan(str(path))


def test_the_paper_plan_with_recorded_states_still_counts_as_the_paper_plan():
    assert is_paper_plan(shrink(BUILTIN_PLANS["paper"], record=Recording.STATES))


def test_paths_of_rules_and_targets_are_relative_to_the_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace("episodes = 12", 'episodes = 12\nrules = "r.yaml"\ntargets = "t.yaml"'))
    office, lab = load_plan(str(path)).scenes
    assert (office.rules, office.targets) == (str(tmp_path / "r.yaml"), str(tmp_path / "t.yaml"))
    assert (lab.rules, lab.targets) == (None, None)


def test_unused_keys_of_a_scene_do_not_change_the_digest(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    plan = load_plan(str(path))
    assert not {"rules", "targets", "allow_outside"} & set(plan.model_dump()["scenes"][0])
    other = plan.scenes[0].model_copy(update={"targets": "t.yaml"})
    assert plan.model_copy(update={"scenes": (other, plan.scenes[1])}).digest != plan.digest


def test_a_ceiling_is_permitted_for_a_stage_and_refused_for_a_built_in_scene() -> None:
    stage = ScenePlan(name="lab", usd="lab.usda", seen=("chair",), episodes=1, ceiling_m=2.6)
    assert ScenePlan.model_validate(stage.model_dump()).ceiling_m == 2.6
    with pytest.raises(ValueError, match="built-in scene has a ceiling"):
        ScenePlan(name="office", episodes=1, ceiling_m=2.6)
    with pytest.raises(ValueError, match="greater than or equal to 1"):
        ScenePlan(name="lab", usd="lab.usda", seen=("chair",), episodes=1, ceiling_m=0.5)


def test_a_copy_of_a_plan_has_the_digest_of_its_own_values() -> None:
    plan = load_plan("demo")
    before = plan.digest
    other = plan.model_copy(update={"seed": plan.seed + 1})
    assert other.digest != before
    assert other.model_copy(update={"seed": plan.seed}).digest == before
    one, same = (plan.model_copy(update={"tiers": {Tier.NEAR: share}}) for share in (1, 1.0))
    assert one.digest == same.digest


def test_shares_over_all_scenes_include_scenes_with_separate_shares() -> None:
    plan = load_plan("demo")
    first, *rest = plan.scenes
    own = first.model_copy(update={"tiers": {Tier.FAR: 1.0}, "episodes": sum(scene.episodes for scene in rest)})
    mixed = plan.model_copy(update={"scenes": (own, *rest)})
    assert mixed.tier_share(Tier.FAR) == pytest.approx((1 + plan.tiers.get(Tier.FAR, 0)) / 2)
    assert sum(map(mixed.split_share, Split)) == pytest.approx(1)


def test_the_success_measure_defaults_to_surface_in_a_plan_file_and_to_centroid_in_an_older_dataset(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    assert load_plan(str(path)).task.success is SuccessMeasure.SURFACE
    assert load_plan(str(path), SuccessMeasure.CENTROID).task.success is SuccessMeasure.CENTROID
    path.write_text(GOOD + '[task]\nsuccess = "centroid"\n')
    assert load_plan(str(path)).task.success is SuccessMeasure.CENTROID
    older = load_plan(str(path))
    assert '"success":' not in older.model_dump_json()
    assert Plan.model_validate_json(older.model_dump_json()) == older


def test_the_balanced_plan_measures_to_the_surface_and_restricts_demonstrations_unlike_the_paper_plan():
    paper, balanced = load_plan("paper"), load_plan("balanced")
    assert paper.task.success is SuccessMeasure.CENTROID
    assert "demonstration" not in paper.model_dump_json()
    assert balanced.task.success is load_plan("demo").task.success is SuccessMeasure.SURFACE
    assert balanced.demonstration == DemonstrationConfig(max_contact_steps=0, target_in_view=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[task]\nsuccess = "edge"\n', "task.success: Input should be 'centroid' or 'surface'"),
        ("[demonstration]\nmax_contact_steps = 1001\n", "demonstration.max_contact_steps"),
        ("[demonstration]\nmax_contact_steps = -1\n", "demonstration.max_contact_steps"),
        ("[demonstration]\ncontacts = 1\n", "demonstration.contacts: no such key"),
        ("task = 3\n", "task: "),
    ],
)
def test_wrong_measures_and_limits_are_named_with_their_key(tmp_path, text, said):
    path = tmp_path / "mine.toml"
    path.write_text(text + GOOD if "=" in text.splitlines()[0] else GOOD + text)
    with pytest.raises(InvalidPlan) as caught:
        load_plan(str(path))
    assert said in str(caught.value)


def test_the_former_key_usd_is_read_as_the_key_file(tmp_path):
    text = 'splits = {train_id = 1.0}\n[[scenes]]\nname = "lab"\n%s = "lab.glb"\nseen = ["chair"]\nepisodes = 1\n'
    plans = []
    for key in ("usd", "file"):
        (tmp_path / "mine.toml").write_text(text % key)
        plans.append(load_plan(str(tmp_path / "mine.toml")))
    assert plans[0] == plans[1]
    assert '"usd":' in plans[1].model_dump_json()
    assert Plan.model_validate_json(plans[0].model_dump_json()) == plans[0]
    assert f'file = "{tmp_path}/lab.glb"' in plan_to_toml(plans[0])
    (tmp_path / "mine.toml").write_text(plan_to_toml(plans[0]))
    assert load_plan(str(tmp_path / "mine.toml")) == plans[0]


def test_folders_of_models_are_relative_to_the_plan_and_its_digest_covers_units_and_folders(tmp_path):
    text = 'splits = {train_id = 1.0}\n[[scenes]]\nname = "lab"\nfile = "lab.obj"\nseen = ["chair"]\nepisodes = 1\n'
    path = tmp_path / "mine.toml"
    path.write_text(text)
    plain = load_plan(str(path))
    path.write_text(text + 'unit = "cm"\nup = "y"\nmodels = ["more", "/opt/models"]\n')
    (scene,) = load_plan(str(path)).scenes
    assert (scene.unit, scene.up, scene.models) == ("cm", "y", (str(tmp_path / "more"), "/opt/models"))
    assert load_plan(str(path)).digest != plain.digest
    assert '"models":' not in plain.model_dump_json()


def test_all_mistakes_are_listed_at_once_with_line_and_suggestion(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(
        'epsiodes = 3\nlanguages = "english"\n[camera]\nfov_deg = 1.57\nnear_m = "x"\n[tiers]\nnera = 1.0\n'
        '[[scenes]]\nname = "offfice"\nepsiodes = 4\nlayout = 3\n'
        '[[scenes]]\nname = "mine"\nfile = "room.usd"\nepisodes = -2\n'
    )
    with pytest.raises(InvalidPlan) as error:
        load_plan(str(path))
    lines = error.value.findings
    for start, line_of_key, words in (
        ("epsiodes: no such key", "line 1)", "`episodes` belongs in the table `scenes`"),
        ("languages: no such key", "line 2)", "did you mean 'language'?"),
        ("camera.fov_deg: not plausible", "line 4)", "degrees, not radians"),
        ("camera.near_m:", "line 5)", "(found 'x'"),
        ("tiers.nera:", "line 7)", "did you mean 'near'?"),
        ("scenes[0].episodes:", "line 8)", "Field required"),
        ("scenes[0].name:", "line 9)", "did you mean 'office'?"),
        ("scenes[0].epsiodes:", "line 10)", "did you mean 'episodes'?"),
        ("scenes[0].layout:", "line 11)", "did you mean 'layouts'?"),
        ("scenes[1]:", "line 12)", "`file` needs `seen = [...]`"),
        ("scenes[1].episodes:", "line 15)", "(found -2"),
    ):
        assert [line for line in lines if line.startswith(start) and line_of_key in line and words in line], (
            start,
            lines,
        )
    assert len(lines) == 11


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('name = "x\n[[scenes]]\n', ["line 1: ", "a quote is missing", '\n      name = "x\n               ^']),
        ("name = two\n", ["line 1: Invalid value", 'a text needs quotes: name = "two"']),
        ("a = [1,\n", ["Invalid value (at end of document)"]),
    ],
)
def test_a_syntax_error_shows_the_line_and_the_probable_cause(tmp_path, text, words):
    path = tmp_path / "x.toml"
    path.write_text(text)
    with pytest.raises(InvalidPlan) as error:
        load_plan(str(path))
    assert all(word in str(error.value) for word in words), str(error.value)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("[camera]\nfov_deg = 1.57", "degrees, not radians"),
        ("[camera]\nz_m = 34.0", "metres, not centimetres"),
        ("[spawn]\nheading_noise_rad = 25", "radians, not degrees"),
        ("[task]\nsuccess_radius_m = 100", "metres, not centimetres"),
    ],
)
def test_a_value_in_another_unit_is_refused_in_a_file_and_read_in_a_dataset(tmp_path, table, said):
    path = tmp_path / "x.toml"
    path.write_text(f'[[scenes]]\nname = "office"\nepisodes = 4\n{table}\n')
    with pytest.raises(InvalidPlan, match=said):
        load_plan(str(path))
    assert parse_plan({"name": "x", **tomllib.loads(path.read_text())}, "a dataset").episodes == 4


def test_a_floor_at_height_zero_is_part_of_the_plan_and_its_digest(tmp_path):
    def plan(line: str) -> Plan:
        path = tmp_path / "x.toml"
        path.write_text(
            f'[[scenes]]\nname = "mine"\nfile = "a.usd"\nseen = ["chair"]\nepisodes = 4\n{line}\n[splits]\ntrain_id = 1'
        )
        return load_plan(str(path))

    flat = plan("floor_m = 0.0")
    assert "floor_m = 0.0" in plan_to_toml(flat)
    assert flat.model_dump(mode="json")["scenes"][0]["floor_m"] == 0.0
    assert len({flat.digest, plan("").digest, plan("floor_m = 1.0").digest}) == 3


def test_the_changed_keys_of_a_plan_are_named_with_both_values():
    recorded = BUILTIN_PLANS["demo"]
    with pytest.raises(
        UsageError, match=r"seed: recorded 42, requested 7\n.*scenes\[0\].episodes: recorded 4, requested 2"
    ):
        require_plan(recorded, shrink(recorded, episodes=8, seed=7))
    assert plan_differences(recorded, recorded) == []


def test_the_page_of_the_keys_and_the_starter_plan_agree_with_the_models(tmp_path):
    keys = list_keys()
    page = Path(__file__).parents[4] / "docs" / "plan-keys.md"
    assert keys_as_markdown(keys) in page.read_text(), "renew docs/plan-keys.md from `factory plan keys --markdown`"
    assert [key.key for key in keys if not key.meaning] == []
    path = tmp_path / "new.toml"
    path.write_text(STARTER)
    assert load_plan(str(path)).episodes == 200


def test_a_scene_a_layout_and_a_family_select_scenes_of_a_plan():
    plan = Plan.model_validate(
        {
            "name": "x",
            "splits": {"train_id": 1},
            "scenes": [{"name": "home", "layouts": 2, "episodes": 4}, {"name": "office", "episodes": 1}],
        }
    )
    assert scenes_named(plan, "home") == ("home_00000", "home_00001")
    assert scenes_named(plan, "home_00001") == ("home_00001",)
    assert scenes_named(plan, "office") == ("office",)
    with pytest.raises(UsageError, match="did you mean 'home'"):
        scenes_named(plan, "hom")
