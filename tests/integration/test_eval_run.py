"""Evaluations with real processes: policy errors, resuming without repetition, and reproducible numbers."""

from __future__ import annotations

import dataclasses
import itertools
import json
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.eval.driving.policy import EpisodeInfo, PolicyInput
from factory.eval.driving.rollout import run_episode, thin_track
from factory.eval.driving.simulator import Simulator
from factory.eval.models.messages import EvalSetup
from factory.eval.models.result import EpisodeResult, EvalEnd, TrainingNote, Variant
from factory.eval.models.spec import SpecSet
from factory.eval.order import require_same_policies
from factory.eval.policies.registry import renders_apart
from factory.eval.process.local_campaign import run_campaign
from factory.eval.results.compare import compare
from factory.eval.results.publish import evaluation_of, pair_folder, publish, training_overlap
from factory.eval.results.score import Evaluation
from factory.eval.results.store import EvalManifest, Store, read_manifest
from factory.eval.results.text import print_evaluation
from factory.eval.specs.campaign import Campaign, playback_sources, tasks_for
from factory.eval.specs.from_dataset import LoadedScenes, specs_of_dataset, splits_of
from schemas.errors import UsageError, WorldError
from schemas.terms import Split
from workers.experts.observation import Observation
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist
from workers.sim.context import SimulationContext

MINE = "tests.builders.policies"
EXAMPLES = Path(__file__).parent.parent.parent / "docs" / "evaluation"


@pytest.fixture(scope="module")
def specs(drives: Dataset) -> SpecSet:
    return specs_of_dataset(drives, [Split.TRAIN_ID, Split.TEST_ID])


def short(specs: SpecSet, steps: int = 30) -> SpecSet:
    task = specs.settings.task.model_copy(update={"max_steps": steps})
    return specs.model_copy(update={"settings": specs.settings.model_copy(update={"task": task})})


def campaign_of(
    drives: Dataset,
    specs: SpecSet,
    *policies: str,
    variants: Sequence[Variant] = (Variant.ORIGINAL,),
    processes: int = 1,
) -> Campaign:
    limits = EvalSetup(settings=specs.settings, act_timeout_s=2.0)
    return Campaign(specs, drives.root, policies, tuple(variants), limits, processes)


def open_store(root: Path, campaign: Campaign) -> Store:
    manifest = EvalManifest(
        run=campaign.specs.run,
        specs_digest=campaign.specs.digest,
        with_pose=False,
        act_timeout_s=2.0,
        latency=campaign.setup.latency,
    )
    return Store(root, campaign.specs, manifest)


def drive(root: Path, campaign: Campaign) -> dict[str, list[EpisodeResult]]:
    with open_store(root, campaign) as store:
        assert run_campaign(campaign, store, threading.Event(), lambda _pace: None)
        return {name: store.results(name) for name in campaign.policies}


def without_clocks(rows: Sequence[EpisodeResult]) -> list[dict[str, Any]]:
    return [row.model_dump(exclude={"act_ms", "seconds"}) for row in rows]


def test_experts_and_replay_reproduce_the_archive(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    found = drive(tmp_path, campaign_of(drives, specs.only(frozenset({Split.TEST_ID}), 1), "expert", "replay"))
    for rows in found.values():
        assert [row.end for row in rows] == [EvalEnd.SUCCESS]
        for row in rows:
            archived = drives[row.spec_id].summary
            assert row.num_steps == archived.num_steps
            assert row.final_ne_m == pytest.approx(archived.final_ne_m, abs=1e-5)
            assert row.trajectory_length_m == pytest.approx(archived.trajectory_length_m, abs=1e-4)
            assert row.spl is not None
            assert row.spl > 0.9


def test_playback_executes_the_actions_of_another_episode_and_stop_executes_none(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    campaign = campaign_of(drives, short(specs, 20), "playback", "stop")
    found = drive(tmp_path, campaign)
    others, places = playback_sources(campaign.specs), LoadedScenes(drives.root)
    with SimulationContext() as stage, Simulator(stage, campaign.specs.settings) as simulator:
        for spec, row in zip(campaign.specs.specs, found["playback"], strict=True):
            simulator.reset(spec, places.load(spec.scene, spec.scene_sha256))
            for v, w in drives[others[spec.spec_id]].actions[:20]:
                simulator.step(Twist(float(v), float(w)))
            assert row.track == thin_track(simulator.track, specs.settings.task.control_hz)
    assert [row.trajectory_length_m < 0.01 for row in found["stop"]] == [True] * 3


def test_a_policy_error_fails_only_its_own_episodes(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    names = [f"{MINE}:{name}" for name in ("Raises", "Dies", "Hangs", "Tokens")]
    found = drive(tmp_path, campaign_of(drives, short(specs, 12).only(None, 2), *names, processes=2))
    ends = {name.partition(":")[2]: [row.end for row in rows] for name, rows in found.items()}
    assert ends == {
        "Raises": [EvalEnd.POLICY_RAISED] * 2,
        "Dies": [EvalEnd.POLICY_DIED] * 2,
        "Hangs": [EvalEnd.POLICY_HUNG] * 2,
        "Tokens": [EvalEnd.TIMEOUT] * 2,
    }
    raised, died, hung, _ = (found[name][0] for name in names)
    assert "KeyError: 'depth_front' (policies.py:" in raised.detail
    assert "exit status 7" in died.detail
    assert "for 2 s" in hung.detail
    assert (raised.num_steps, hung.num_steps) == (3, 5)
    assert 0.0 < hung.trajectory_length_m < 0.1  # accelerates at 2.5 m/s2 for a quarter of a second
    assert hung.final_ne_m < hung.spawn_dist_m


def test_a_policy_that_keeps_state_between_episodes_is_noted(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    names = [f"{MINE}:{name}" for name in ("Forgets", "Resets")]
    campaign = campaign_of(drives, short(specs, 12), *names)
    drive(tmp_path, campaign)
    with open_store(tmp_path, campaign) as store:
        forgets, resets = (store.note_of(name) for name in names)
        assert forgets is not None
        assert "Forgets keeps state between episodes" in (forgets.order_dependence or "")
        assert resets is not None
        assert resets.order_dependence is None
        warnings = [remark for remark in evaluation_of(campaign, store).remarks if remark.startswith("warning")]
    assert len(warnings) == 1
    assert "in reset()" in warnings[0]


@pytest.mark.gl
def test_policies_run_in_a_process_without_a_graphics_driver(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    """A built-in policy is evaluated first; its process renders in-process and has loaded the driver."""
    names = ("expert", f"{MINE}:ChecksDriver", "stop")
    campaign = campaign_of(drives, short(specs, 12).only(None, 2), *names)
    setup = campaign.setup.model_copy(update={"renderer": "gl"})
    found = drive(tmp_path, dataclasses.replace(campaign, setup=setup))
    assert {row.end for rows in found.values() for row in rows} == {EvalEnd.TIMEOUT}, found
    assert renders_apart("bc:somewhere")
    assert not any(renders_apart(name) for name in ("expert:depth", "planner", "replay", "random", "ws://h:1"))


def test_invalid_actions_are_described_in_the_failure(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    rows = drive(tmp_path, campaign_of(drives, short(specs), f"{MINE}:InvalidAnswers"))[f"{MINE}:InvalidAnswers"]
    assert [row.end for row in rows] == [EvalEnd.POLICY_INVALID] * 3
    details = [row.detail for row in rows]
    assert "nan" in details[0]
    assert "found (3,)" in details[1]
    assert "found a str" in details[2]


def test_a_policy_receives_only_camera_and_instruction_even_under_ablation(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    campaign = campaign_of(drives, short(specs, 10), f"{MINE}:ChecksInput", "stop", variants=tuple(Variant))
    found = drive(tmp_path, campaign)
    rows = found[f"{MINE}:ChecksInput"]
    assert len(rows) == 12
    assert {row.end for row in rows} == {EvalEnd.TIMEOUT}, rows[0].detail
    yaw_change = {row.variant: abs(row.track[-1][2] - row.track[0][2]) for row in rows}
    assert yaw_change[Variant.EMPTY] > 0.01 > yaw_change[Variant.WRONG]
    assert {row.instruction for row in rows if row.variant is Variant.EMPTY} == {""}
    assert len(found["stop"]) == 3  # not evaluated under ablation, because it reads no instruction
    with open_store(tmp_path, campaign) as store:
        evaluation = publish(campaign, store, videos=0)
    listens, stop = evaluation.policies
    assert evaluation.complete
    assert [row.variant for row in listens.ablation if row.by == "all"] == ["shuffled", "wrong", "empty"]
    assert (listens.knows, stop.knows) == ("camera, instruction and odometry", "nothing")
    assert not stop.reads_instruction


def test_a_stopped_evaluation_resumes_and_gives_the_same_numbers(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    campaign = campaign_of(drives, short(specs, 15), "random")
    stop = threading.Event()
    with open_store(tmp_path / "torn", campaign) as store:
        assert not run_campaign(campaign, store, stop, lambda pace: stop.set() if pace.done else None)
        done = [row.spec_id for row in store.results("random")]
        assert 1 <= len(done) < 3
        before = store.results("random")
    told: list[int] = []
    with open_store(tmp_path / "torn", campaign) as store:
        assert run_campaign(campaign, store, threading.Event(), lambda pace: told.append(pace.done))
        after = store.results("random")
    assert told[0] == len(done)
    assert told[-1] == 3
    assert [row for row in after if row.spec_id in done] == before  # equal wall times: not run again
    uninterrupted = drive(tmp_path / "uninterrupted", campaign)["random"]
    assert without_clocks(uninterrupted) == without_clocks(after)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (f"{MINE}:Absent", r"no class 'Absent'; .*policies.py has .*Raises"),
        ("tests.builders.absent:X", "no module 'tests.builders.absent'; looked in"),
        (f"{MINE}:NoMethods", "no method reset and no act"),
        (f"{MINE}:CannotBeConstructed", r"FileNotFoundError: weights.pt \(.*policies.py:"),
    ],
)
def test_a_policy_that_cannot_be_constructed_stops_the_evaluation_with_the_reason(
    drives: Dataset, specs: SpecSet, tmp_path: Path, policy: str, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        drive(tmp_path, campaign_of(drives, short(specs), policy))


def test_a_dataset_without_its_scene_is_refused(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    other = specs.specs[0].model_copy(update={"scene_sha256": "f" * 64})
    with pytest.raises(WorldError, match=r"the package of scene office with SHA-256 f{64} is missing: .* searched: "):
        drive(tmp_path, campaign_of(drives, specs.model_copy(update={"specs": (other,)}), "stop"))


def test_specs_that_do_not_fit_their_scene_are_refused(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    other = specs.specs[0].model_copy(update={"target_id": "chair_404"})
    with pytest.raises(WorldError, match="no target chair_404"):
        drive(tmp_path, campaign_of(drives, specs.model_copy(update={"specs": (other,)}), "stop"))


def test_a_policy_that_is_edited_after_an_interruption_is_refused(
    drives: Dataset, specs: SpecSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "code").mkdir()
    monkeypatch.chdir(tmp_path / "code")
    code = "class Mine:\n    def reset(self, *_): ...\n    def act(self, _): return {v}, 0.0\n"
    file = tmp_path / "code/edited_policy.py"
    file.write_text(code.format(v=0.1))
    whole = campaign_of(drives, short(specs, 5), "edited_policy:Mine")
    part = replace(whole, processes=1)
    stop = threading.Event()
    with open_store(tmp_path / "out", part) as store:
        assert not run_campaign(part, store, stop, lambda pace: stop.set() if pace.done else None)
        before = store.results("edited_policy:Mine")
        assert 0 < len(before) < len(specs.specs)
    file.write_text(code.format(v=0.2))
    with open_store(tmp_path / "out", whole) as store:
        with pytest.raises(
            UsageError, match=r"not the one whose results are in .*edited_policy.py: [0-9a-f]{12}, now [0-9a-f]{12}"
        ):
            run_campaign(whole, store, threading.Event(), lambda _pace: None)
        assert store.results("edited_policy:Mine") == before
        store.set_aside("edited_policy:Mine")
        assert run_campaign(whole, store, threading.Event(), lambda _pace: None)
        assert len(store.results("edited_policy:Mine")) == len(specs.specs)


def test_a_named_policy_keeps_its_name_and_another_one_of_that_name_is_refused(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    campaign = replace(campaign_of(drives, short(specs.only(None, 1), 3), "mine"), references={"mine": "stop"})
    assert [row.policy for row in drive(tmp_path, campaign)["mine"]] == ["mine"]
    with open_store(tmp_path, campaign) as store:
        note = store.note_of("mine")
        assert note is not None
        assert (note.policy, note.reference, note.reads_instruction) == ("mine", "stop", False)
        require_same_policies(campaign, store)
        with pytest.raises(UsageError, match="are those of stop, not of random: give another name"):
            require_same_policies(replace(campaign, references={"mine": "random"}), store)


def test_episodes_that_one_policy_completes_are_filmed_with_both_policies(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    campaign = campaign_of(drives, specs.only(frozenset({Split.TEST_ID}), 1), "expert", "stop")
    drive(tmp_path, campaign)
    with open_store(tmp_path, campaign) as store:
        evaluation = publish(campaign, store, videos=1)
    (comparison,) = evaluation.comparisons
    assert (comparison.only_first, comparison.pairs) == (1, 1)
    folder = pair_folder(tmp_path, "expert", "stop")
    with av.open(str(folder / f"{campaign.specs.specs[0].spec_id}.mp4")) as film:
        pictures = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert {picture.shape for picture in pictures} == {(648, 640, 3)}
    first, last = (picture.astype(int) for picture in (pictures[0], pictures[-1]))
    above, below = slice(0, 320), slice(328, 648)
    assert np.abs(first[above, :320] - first[below, :320]).mean() < 3  # both start at one pose
    assert np.abs(last[below, :320] - first[below, :320]).mean() < 3  # the motionless policy sees the start
    assert np.abs(last[above, :320] - first[above, :320]).mean() > 10
    assert "expert succeeds" not in (tmp_path / "index.html").read_text()  # one episode shows nothing
    assert "No difference between expert and stop is shown in 1 episode" in (tmp_path / "index.html").read_text()


def test_the_default_evaluates_every_episode_of_the_test_splits_and_all_also_those_of_training(drives: Dataset) -> None:
    splits = drives.column("split").to_pylist()
    tested = specs_of_dataset(drives, splits_of(drives, None)).specs
    assert len(tested) == sum(split.startswith("test_") for split in splits) == 2
    assert len(specs_of_dataset(drives, splits_of(drives, ())).specs) == len(splits) == 3


def test_evaluated_training_episodes_are_named(
    drives: Dataset, specs: SpecSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = campaign_of(drives, short(specs, 4), "stop")
    with open_store(tmp_path, campaign) as store:
        run_campaign(campaign, store, threading.Event(), lambda _pace: None)
        rows, note = store.results("stop"), store.note_of("stop")
        assert note is not None
        training = TrainingNote(digest=drives.filter(split="train_id").digest, episodes=1)
        note = note.model_copy(update={"training": training})
        # without starts, as in a checkpoint of format 2, the digest of the split decides
        overlap = training_overlap(campaign, note, rows)
        assert overlap is not None
        assert (overlap.train_digest, overlap.evaluation_digest) == (training.digest, drives.digest)
        assert (overlap.trained_on, overlap.episodes) == (1, 3)
        unknown = note.model_copy(update={"training": TrainingNote(digest="0" * 64, episodes=9)})
        assert training_overlap(campaign, unknown, rows) == overlap.model_copy(
            update={"train_digest": "0" * 64, "train_episodes": 9, "trained_on": None}
        )
        flagged = [row.model_copy(update={"trained_on": row.split == "test_id"}) for row in rows]
        assert getattr(training_overlap(campaign, unknown, flagged), "trained_on", None) == 2
        store.note(note)
        publish(campaign, store, 0)
        print_evaluation(evaluation_of(campaign, store))
    said = " ".join(capsys.readouterr().out.split())
    page = " ".join((tmp_path / "index.html").read_text().split())
    for text in (said, page):
        assert "stop: warning: trained on 1 of the 3 evaluated episodes (training digest" in text
        assert "1 of train_id are among the 3 episodes" in text
    assert Evaluation.model_validate_json((tmp_path / "results.json").read_bytes()).policies[0].training == overlap


def test_latency_moves_the_world_with_the_former_command(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    names = [f"{MINE}:{name}" for name in ("TellsSteps", "ThinksAndTellsSteps")]
    told, rows = {}, {}
    for latency in (None, 100.0, "real"):
        campaign = campaign_of(drives, short(specs, 60).only(None, 1), *names)
        setup = campaign.setup.model_copy(update={"latency": latency})
        campaign = dataclasses.replace(campaign, setup=setup)
        found = drive(tmp_path / str(latency), campaign)
        told[latency] = [json.loads(found[name][0].detail.partition(": ")[2].partition(" (")[0]) for name in names]
        rows[latency] = found[names[0]]
    assert told[None] == [[0, 2, 4, 6]] * 2
    assert told[100.0] == [[0, 2, 6, 10]] * 2  # two steps of 50 ms while the second and the third answer are awaited
    assert all(later - former >= 6 for former, later in itertools.pairwise(told["real"][1][1:]))  # 4 for 0.2 s
    assert told["real"][1][1] == 2
    assert rows[100.0][0].trajectory_length_m > rows[None][0].trajectory_length_m
    with pytest.raises(UsageError, match="no original episode in common"):
        compare(rows[None], rows[100.0], Variant.ORIGINAL)
    with pytest.raises(UsageError, match=r"another evaluation \(latency 100\.0, now None\)"):
        Store(
            tmp_path / "100.0", campaign.specs, read_manifest(tmp_path / "100.0").model_copy(update={"latency": None})
        )


def test_the_results_state_the_latency(drives: Dataset, specs: SpecSet, tmp_path: Path) -> None:
    remarks = []
    for latency in (250.0, "real"):
        campaign = campaign_of(drives, short(specs, 4), "stop")
        campaign = dataclasses.replace(campaign, setup=campaign.setup.model_copy(update={"latency": latency}))
        with open_store(tmp_path / str(latency), campaign) as store:
            run_campaign(campaign, store, threading.Event(), lambda _pace: None)
            evaluation = evaluation_of(campaign, store)
        assert evaluation.latency == latency
        remarks.append(" ".join(evaluation.remarks))
    assert "takes 250 ms" in remarks[0]
    assert "not reproducible" not in remarks[0]
    assert "these results are not reproducible" in remarks[1]


def test_a_good_server_logs_no_error_at_the_end_of_an_evaluation(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    command = [sys.executable, str(EXAMPLES / "policy_server.py"), "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split()[-1]
            found = drive(tmp_path, campaign_of(drives, short(specs, 8), address, processes=2))
            assert [row.end for row in found[address]] == [EvalEnd.TIMEOUT] * 3
        finally:
            process.terminate()
            errors = process.communicate()[1]
    assert errors == ""


def test_a_long_wait_is_shown_with_its_limit_and_limits_are_in_the_results(
    drives: Dataset, specs: SpecSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"{MINE}:LoadsSlowly"
    campaign = campaign_of(drives, short(specs, 7).only(None, 1), name)
    waits = []
    with open_store(tmp_path, campaign) as store:
        assert run_campaign(campaign, store, threading.Event(), lambda pace: waits.append(pace.waiting))
        assert [wait for wait in waits if wait] == [
            "waiting for loading, reset or first answer, at most 300 s (--load-timeout)"
        ]
        publish(campaign, store, 0)
        print_evaluation(evaluation_of(campaign, store))
    said = (
        "7 steps (0.35 s) for an episode; 2 s for an answer; 300 s for loading a policy, a reset and the first answer"
    )
    assert f"limits: {said}" in " ".join(capsys.readouterr().out.split())
    assert f"Limits: {said}." in (tmp_path / "index.html").read_text()
    limits = json.loads((tmp_path / "results.json").read_text())["limits"]
    assert limits == {"max_steps": 7, "control_hz": 20, "act_timeout_s": 2.0, "load_timeout_s": 300.0}


class CountsRenders:
    """Observer of policy calls that counts the rendered frames."""

    renders = 0

    def before_call(self, simulator: Simulator, view: Observation) -> None: ...

    def after_call(self) -> None: ...

    def before_render(self) -> None:
        self.renders += 1

    def after_render(self) -> None: ...


class LooksAtSome:
    """Does not move; keeps all observations, and reads the images of every tenth."""

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        self.seen: list[PolicyInput] = []
        self.images: dict[int, tuple[Any, Any]] = {}

    def act(self, observation: PolicyInput) -> Any:
        self.seen.append(observation)
        if observation["step"] % 10 == 0:
            self.images[observation["step"]] = observation["rgb"].copy(), observation["depth"].copy()
        if observation["step"] == 25:
            kept = self.seen[3]  # reads an image of an earlier step
            self.images[3] = kept["rgb"].copy(), kept["depth"].copy()
        return 0.0, 0.0


def test_images_that_a_policy_does_not_read_are_not_rendered_and_others_equal_rendering(
    drives: Dataset, specs: SpecSet
) -> None:
    campaign = campaign_of(drives, short(specs, 30).only(None, 1), f"{MINE}:Looks")
    places, policy, observer = LoadedScenes(drives.root), LooksAtSome(), CountsRenders()
    (task,) = tasks_for(campaign, campaign.policies[0], places)
    loaded = places.load(task.request.spec.scene, task.request.spec.scene_sha256)
    with SimulationContext() as stage, Simulator(stage, campaign.specs.settings) as simulator:
        run_episode(task, policy, simulator, loaded, observer)
        assert sorted(policy.images) == [0, 3, 10, 20]
        assert observer.renders == 4
        for step, (rgb, depth) in policy.images.items():
            frame = simulator.shown.renderer.render(Pose(*simulator.track[step]))
            np.testing.assert_array_equal(rgb, frame.rgb)
            np.testing.assert_array_equal(depth, frame.depth)


def test_two_classes_of_one_folder_are_not_hashed_together(
    drives: Dataset, specs: SpecSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "code"
    folder.mkdir()
    for name in ("one_pilot", "other_pilot"):
        text = "class Pilot:\n    def reset(self, *_): ...\n    def act(self, _):\n        return 0.0, 0.0\n"
        (folder / f"{name}.py").write_text(text)
    monkeypatch.chdir(folder)
    names = ("one_pilot:Pilot", "other_pilot:Pilot")
    campaign = campaign_of(drives, short(specs.only(None, 1), 2), *names)
    drive(tmp_path / "out", campaign)
    with open_store(tmp_path / "out", campaign) as store:
        notes = [store.note_of(name) for name in names]
    assert [[*note.made_from] for note in notes if note is not None] == [["one_pilot.py"], ["other_pilot.py"]]
