"""`factory train bc` on small datasets: training, resuming to the same weights, driving, and error messages."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

from factory.dataset.reader import Dataset
from factory.eval.driving.action import read_actions
from factory.eval.driving.policy import EpisodeInfo, PolicyInput
from factory.eval.models.messages import EvalSetup, PolicyLimits
from factory.eval.models.result import Variant
from factory.eval.models.spec import write_specs
from factory.eval.policies.registry import find_policy, make_policy
from factory.eval.process.local_campaign import run_campaign
from factory.eval.results.publish import evaluation_of
from factory.eval.specs.campaign import Campaign
from factory.eval.specs.from_dataset import specs_of_dataset, splits_of
from factory.train.behaviour_cloning import TrainCallbacks, TrainOrder, is_better, train_bc
from factory.train.checkpoint import POLICY, read_checkpoint
from factory.train.curve import write_curve
from factory.train.measures import EpochMeasures, TrainReport
from factory.train.options import BcOptions
from schemas.errors import UsageError, WorldError
from schemas.support.extras import install_command
from schemas.terms import Recording, Split
from tests.builders.dataset import make_dataset
from tests.builders.evaluation import open_store
from tests.builders.needs_torch import needs_torch, needs_weights
from workers.client.host_lock import sole_use

INFO = EpisodeInfo("spec_1", 7, 60, 1000, (0.0, 1.0), (-1.5, 1.5), 90.0)
# torch 2.13 warns about a deprecated Python feature that it uses
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits PyTorch to one thread, because small networks are slower with several, above all on a busy machine."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    if importlib.util.find_spec("torch") is not None:
        import torch

        torch.set_num_threads(1)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("train") / "data"
    make_dataset(root, 2)
    return root


def options(**changes: Any) -> BcOptions:
    return BcOptions(**{"epochs": 3, "size": 64, "width": 4, "batch": 4, "hold": 3} | changes)


def train(root: Path, out: Path, options: BcOptions, stop_after: int = 99) -> list[float]:
    """Trains until the end or for `stop_after` epochs; returns the losses of all epochs of the report."""
    seen: list[int] = []
    watcher = TrainCallbacks(
        caching=lambda _done, _of: None,
        learning=lambda _epochs, _done, _of, _loss: None,
        measured=lambda measured: seen.append(measured.epoch),
        is_stopped=lambda: len(seen) >= stop_after,
    )
    report = train_bc(TrainOrder(Dataset(root), out, options, device="auto"), watcher)
    return [epoch.train_loss for epoch in report.epochs]


def weights(out: Path) -> dict[str, np.ndarray[Any, Any]]:
    from factory.train.checkpoint import read_checkpoint

    return {name: tensor.numpy() for name, tensor in read_checkpoint(out).tensors["model"].items()}


def observation(step: int = 0) -> PolicyInput:
    rgb = np.random.default_rng(step).integers(0, 256, (640, 640, 3), dtype=np.uint8)
    return PolicyInput(rgb=rgb, depth=np.full((640, 640), 2.0, np.float32), instruction="", step=step)


@pytest.mark.skipif(importlib.util.find_spec("torch") is not None, reason="torch is installed")
def test_without_torch_the_extra_is_named(root: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "factory", "train", "bc", str(root), "-o", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert install_command("train") in done.stderr
    assert not (tmp_path / "out").exists()
    with pytest.raises(UsageError, match=re.escape(install_command("train"))):
        make_policy(f"bc:{tmp_path}", PolicyLimits())


def test_a_trained_policy_declares_that_it_reads_its_instruction() -> None:
    assert find_policy("bc:anything").reads_instruction


@needs_torch
@pytest.mark.parametrize("head", ["continuous", "tokens"])
def test_training_overfits_a_small_dataset(root: Path, tmp_path: Path, head: str) -> None:
    losses = train(root, tmp_path / "out", options(head=head, epochs=12, peak_rate=1e-2))
    assert losses[-1] < 0.8 * losses[0]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        ".lock",
        "policy.pt",
        "state.pt",
        "metrics.json",
        "tensorboard",
    }
    assert any((tmp_path / "out" / "tensorboard").iterdir())


@needs_torch
def test_a_resumed_training_has_the_weights_of_an_uninterrupted_training(root: Path, tmp_path: Path) -> None:
    whole = train(root, tmp_path / "whole", options())
    train(root, tmp_path / "parts", options(), stop_after=1)
    assert train(root, tmp_path / "parts", options()) == whole
    one, two = weights(tmp_path / "whole"), weights(tmp_path / "parts")
    assert one.keys() == two.keys()
    assert all(np.array_equal(one[name], two[name]) for name in one)


@needs_torch
def test_a_second_training_in_the_same_folder_is_refused(root: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with (
        sole_use(tmp_path / "out", "training"),
        pytest.raises(WorldError, match="is in use by another training: wait for its end, or choose another -o"),
    ):
        train(root, tmp_path / "out", options())


@needs_torch
def test_a_training_stops_within_an_epoch_and_repeats_it(root: Path, tmp_path: Path) -> None:
    whole = train(root, tmp_path / "whole", options())
    batches: list[int] = []
    report = train_bc(
        TrainOrder(Dataset(root), tmp_path / "parts", options()),
        TrainCallbacks(
            caching=lambda _done, _of: None,
            learning=lambda _epochs, done, _of, _loss: batches.append(done),
            measured=lambda _measured: None,
            is_stopped=lambda: batches[1:].count(1) == 1,  # the first batch of the second epoch
        ),
    )
    assert (len(report.epochs), report.finished) == (1, False)
    assert train(root, tmp_path / "parts", options()) == whole
    one, two = weights(tmp_path / "whole"), weights(tmp_path / "parts")
    assert all(np.array_equal(one[name], two[name]) for name in one)


@needs_weights
@pytest.mark.parametrize("head", ["continuous", "tokens"])
def test_a_larger_policy_learns_and_resumes_with_the_same_weights(root: Path, tmp_path: Path, head: str) -> None:
    larger = options(encoder="efficientnet_lite0", head=head, peak_rate=3e-3)
    whole = train(root, tmp_path / "whole", larger)
    assert whole[-1] < whole[0]
    train(root, tmp_path / "parts", larger, stop_after=1)
    assert train(root, tmp_path / "parts", larger) == whole
    one, two = weights(tmp_path / "whole"), weights(tmp_path / "parts")
    assert all(np.array_equal(one[name], two[name]) for name in one)
    policy = make_policy(f"bc:{tmp_path / 'whole'}", PolicyLimits())
    policy.reset("Go to the chair.", INFO)
    assert np.isfinite(read_actions(policy.act(observation()), "continuous", 1.0, 1.5).twists).all()


@needs_weights
def test_the_encoder_keeps_its_first_blocks_and_the_statistics_of_its_norms(root: Path, tmp_path: Path) -> None:
    from factory.train.efficientnet import EfficientNetLite0, load_weights

    encoder = EfficientNetLite0()
    load_weights(encoder)
    given = {  # as float16, in which the weights of the larger policy are written
        f"encoder.{name}": (tensor.half() if tensor.is_floating_point() else tensor).numpy()
        for name, tensor in encoder.state_dict().items()
    }
    train(root, tmp_path / "out", options(encoder="efficientnet_lite0", epochs=1, peak_rate=1e-2))
    trained = weights(tmp_path / "out")
    same = {name for name in given if np.array_equal(given[name], trained[name])}
    assert {name for name in given if "running" in name} <= same
    assert {name for name in given if name.startswith(("encoder._conv_stem", "encoder._blocks.2."))} <= same
    assert "encoder._blocks.3._expand_conv.weight" not in same


@needs_weights
def test_the_weights_are_those_that_the_file_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from factory.train import efficientnet

    damaged = tmp_path / "weights.pth"
    damaged.write_bytes(efficientnet.weights_file().read_bytes()[:-1])
    monkeypatch.setattr(efficientnet, "weights_file", lambda: damaged)
    with pytest.raises(WorldError, match=r"is damaged .* install its package again"):
        efficientnet.load_weights(efficientnet.EfficientNetLite0())


def test_a_size_that_the_encoder_cannot_read_is_refused() -> None:
    with pytest.raises(ValidationError, match="80 is not a multiple of 32 px"):
        options(encoder="efficientnet_lite0", size=80)


@needs_weights
def test_a_budget_chooses_sizes_and_an_interrupted_training_keeps_them(root: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "factory", "train", "policy", str(root), "-o", str(tmp_path / "out")]
    command += ["--budget", "0.01", "--batch", "4", "--minutes", "0.01"]
    first = subprocess.run(command, capture_output=True, text=True, check=False)
    assert first.returncode == 0, first.stderr
    chosen = re.findall(r"--budget 0.01: (--size \d+ --epochs \d+)", first.stderr)
    assert len(chosen) == 1
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert re.findall(r"--budget 0.01: (--size \d+ --epochs \d+)", again.stderr) == chosen
    both = subprocess.run([*command, "--size", "64"], capture_output=True, text=True, check=False)
    assert both.returncode == 2
    assert "--budget chooses --size and --epochs: omit these, or omit --budget" in both.stderr


@needs_torch
def test_only_a_training_is_limited_to_deterministic_algorithms(root: Path, tmp_path: Path) -> None:
    import torch

    seen: list[bool] = []
    watcher = TrainCallbacks(
        lambda *_: None,
        lambda *_: seen.append(torch.are_deterministic_algorithms_enabled()),
        lambda _: None,
        lambda: False,
    )
    train_bc(TrainOrder(Dataset(root), tmp_path, options(epochs=1), device="auto"), watcher)
    assert set(seen) == {True}
    assert not torch.are_deterministic_algorithms_enabled()


@needs_torch
def test_resuming_with_other_options_is_refused_with_their_names(root: Path, tmp_path: Path) -> None:
    train(root, tmp_path, options(), stop_after=1)
    held = (tmp_path / "state.pt").read_bytes()
    with pytest.raises(UsageError, match=r"other options \(seed \d+, now 5; size 64, now 80\): give the same"):
        train(root, tmp_path, options(seed=5, size=80))
    assert (tmp_path / "state.pt").read_bytes() == held


@needs_torch
def test_resuming_with_other_episodes_is_refused(root: Path, tmp_path: Path) -> None:
    train(root, tmp_path, options(), stop_after=1)
    order = TrainOrder(Dataset(root).filter(episode="ep_000001"), tmp_path, options(), device="auto")
    watcher = TrainCallbacks(lambda *_: None, lambda *_: None, lambda _: None, lambda: False)
    with pytest.raises(UsageError, match=r"on other episodes \(\d+ episodes, .* now \d+ episodes"):
        train_bc(order, watcher)


@needs_torch
def test_the_seed_determines_the_weights(root: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        train(root, tmp_path / name, options(seed=seed, epochs=1))
    one, same, other = (weights(tmp_path / name) for name in "abc")
    assert all(np.array_equal(one[name], same[name]) for name in one)
    assert any(not np.array_equal(one[name], other[name]) for name in one)


@needs_torch
@pytest.mark.parametrize("head", ["continuous", "tokens"])
def test_the_policy_returns_the_same_action_for_each_held_step(root: Path, tmp_path: Path, head: str) -> None:
    train(root, tmp_path, options(head=head, epochs=1))
    policy = make_policy(f"bc:{tmp_path}", PolicyLimits())
    policy.reset("Go to the chair.", INFO)
    for step in range(3):
        chunk = read_actions(policy.act(observation(step)), "continuous", 1.0, 1.5)
        assert len(chunk.twists) == 3
        assert chunk.beyond == 0
        assert len(set(chunk.twists)) == 1


@needs_torch
def test_the_instruction_changes_the_action_except_in_the_ablated_model(root: Path, tmp_path: Path) -> None:
    for name, ablate in (("reads", False), ("blind", True)):
        train(root, tmp_path / name, options(epochs=2, ablate_language=ablate, positions=not ablate))
        policy = make_policy(f"bc:{tmp_path / name}", PolicyLimits())
        answers = []
        for instruction in ("Go to the chair.", "Approach the red sofa and stop."):
            policy.reset(instruction, INFO)
            answers.append(np.asarray(policy.act(observation())))
        assert np.array_equal(*answers) is ablate


@needs_torch
def test_another_control_rate_or_camera_is_refused(root: Path, tmp_path: Path) -> None:
    train(root, tmp_path, options(epochs=1))
    policy = make_policy(f"bc:{tmp_path}", PolicyLimits())
    with pytest.raises(UsageError, match=r"trained at 60 Hz .* the episodes have 30 Hz"):
        policy.reset("Go to the chair.", INFO.__class__("spec_1", 7, 30, 1000, (0.0, 1.0), (-1.5, 1.5), 90.0))


@needs_torch
def test_a_file_that_is_not_a_checkpoint_is_refused_before_loading(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"checkpoint .*nothing.* does not exist"):
        make_policy(f"bc:{tmp_path / 'nothing'}", PolicyLimits())
    import torch

    torch.save({"meta": "{}"}, tmp_path / "policy.pt")
    with pytest.raises(UsageError, match="not a checkpoint that this version reads"):
        make_policy(f"bc:{tmp_path}", PolicyLimits())
    (tmp_path / "policy.pt").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(WorldError, match="damaged or not a checkpoint"):
        make_policy(f"bc:{tmp_path}", PolicyLimits())


class WritesOnUnpickling:
    """Object that writes a file when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        import os

        return os.system, (f"touch '{self._file}'",)


@needs_torch
def test_loading_a_checkpoint_executes_no_code(tmp_path: Path) -> None:
    import torch

    torch.save({"meta": "{}", "model": WritesOnUnpickling(tmp_path / "written")}, tmp_path / "policy.pt")
    with pytest.raises(WorldError, match="damaged or not a checkpoint"):
        make_policy(f"bc:{tmp_path}", PolicyLimits())
    assert not (tmp_path / "written").exists()


@needs_torch
def test_the_command_prints_its_report_and_resumes(root: Path, tmp_path: Path) -> None:
    base = [sys.executable, "-m", "factory", "train", "bc", str(root), "-o", str(tmp_path), "--size", "64"]
    first = subprocess.run(
        [*base, "--epochs", "1", "--json", "--device", "cpu"], capture_output=True, text=True, check=False
    )
    assert first.returncode == 0, first.stderr
    report = json.loads(first.stdout)
    assert report["finished"] is True
    assert len(report["epochs"]) == 1
    assert report["val_episodes"] == 0
    assert report == json.loads((tmp_path / "metrics.json").read_text())
    again = [*base, "--epochs", "1", "--device", "cpu"]
    second = subprocess.run([*again, "--json"], capture_output=True, text=True, check=False)
    assert (second.returncode, json.loads(second.stdout)["epochs"]) == (0, report["epochs"])
    third = subprocess.run([*base, "--epochs", "2"], capture_output=True, text=True, check=False)
    assert third.returncode == 2
    assert "epochs 1, now 2" in third.stderr


@needs_torch
def test_an_evaluation_counts_the_episodes_that_the_policy_was_trained_on(
    recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    dataset = Dataset(recordings[Recording.FRAMES])
    (seen,) = dataset.filter(target=dataset.column("target_id").to_pylist()[0]).column("episode_id").to_pylist()
    order = TrainOrder(dataset.filter(episode=seen), tmp_path / "out", options(epochs=1), device="cpu")
    train_bc(order, TrainCallbacks(lambda *_: None, lambda *_: None, lambda _: None, lambda: False))
    specs = specs_of_dataset(dataset, splits_of(dataset, ()))
    task = specs.settings.task.model_copy(update={"max_steps": 3})
    specs = specs.model_copy(update={"settings": specs.settings.model_copy(update={"task": task})})
    setup, name = EvalSetup(settings=specs.settings), f"bc:{tmp_path / 'out'}"
    campaign = Campaign(specs, dataset.root, (name,), (Variant.ORIGINAL,), setup)
    with open_store(tmp_path / "results", campaign) as store:
        assert run_campaign(campaign, store, threading.Event(), lambda _pace: None)
        rows = store.results(name)
        (policy,) = evaluation_of(campaign, store).policies
    assert [row.trained_on for row in rows] == [row.spec_id == seen for row in rows]
    assert policy.training is not None
    assert (policy.training.trained_on, policy.training.episodes) == (1, 2)
    assert policy.training.train_digest == dataset.filter(episode=seen).digest


@needs_torch
def test_a_replaced_checkpoint_never_continues_the_results_of_the_former_one(
    recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    dataset, out, checkpoint = Dataset(recordings[Recording.FRAMES]), tmp_path / "results", tmp_path / "bc" / POLICY
    specs = specs_of_dataset(dataset, splits_of(dataset, ()))
    task = specs.settings.task.model_copy(update={"max_steps": 3})
    write_specs(
        specs.model_copy(update={"settings": specs.settings.model_copy(update={"task": task})}), tmp_path / "specs"
    )
    for seed in (0, 1):
        train(dataset.root, tmp_path / str(seed), options(epochs=1, seed=seed))
    hashes = [hashlib.sha256((tmp_path / str(seed) / POLICY).read_bytes()).hexdigest() for seed in (0, 1)]
    rows, former = out / "policies" / "mine" / "episodes.jsonl", out / "former" / "mine-1"

    def evaluate(seed: int, *more: str) -> subprocess.CompletedProcess[str]:
        checkpoint.parent.mkdir(exist_ok=True)
        shutil.copyfile(tmp_path / str(seed) / POLICY, checkpoint)
        words = [dataset.root, "--policy", f"mine=bc:{checkpoint.parent}", "-o", out, "--workers", "1"]
        command = [sys.executable, "-m", "factory", "eval", *words, "--specs", tmp_path / "specs", "--videos", "0"]
        return subprocess.run([*command, *more], capture_output=True, text=True, check=False)

    def made_from() -> str:
        (policy,) = json.loads((out / "results.json").read_text())["policies"]
        return str(policy["made_from"][POLICY])

    first = evaluate(0)
    assert (first.returncode, made_from()) == (0, hashes[0]), first.stderr
    whole = rows.read_bytes()
    assert len(whole.splitlines()) == 2
    for kept in (whole, whole.splitlines(keepends=True)[0]):  # finished, and interrupted after the first episode
        rows.write_bytes(kept)
        refused = evaluate(1)
        assert refused.returncode == 2
        assert f"{POLICY}: {hashes[0][:12]}, now {hashes[1][:12]}" in refused.stderr
        assert "--restart" in refused.stderr
        assert (rows.read_bytes(), former.exists()) == (kept, False)
    assert evaluate(0).returncode == 0
    assert made_from() == hashes[0]
    restarted = evaluate(1, "--restart")
    assert (restarted.returncode, made_from()) == (0, hashes[1]), restarted.stderr
    assert len((former / "episodes.jsonl").read_bytes().splitlines()) == len(rows.read_bytes().splitlines()) == 2
    assert (former / "episodes.jsonl").read_bytes() != rows.read_bytes()
    assert str(former) in restarted.stderr


def epoch_of(number: int, val_loss: float | None) -> EpochMeasures:
    values = dict.fromkeys(("val_v_mps", "val_w_rps", "stop_precision", "stop_recall", "pointing"))
    return EpochMeasures(epoch=number, train_loss=1 / number, val_loss=val_loss, rate=0.001, seconds=1.0, **values)


@pytest.mark.parametrize(
    ("losses", "kept"), [((0.3, 0.1, 0.2), 2), ((0.2, 0.1, 0.1), 2), ((None, None, None), 3), ((0.1, 0.2, 0.3), 1)]
)
def test_the_epoch_with_the_smallest_validation_loss_is_kept(losses: tuple[float | None, ...], kept: int) -> None:
    best: EpochMeasures | None = None
    for number, loss in enumerate(losses, 1):
        new = epoch_of(number, loss)
        best = new if is_better(new, best) else best
    assert best is not None
    assert best.epoch == kept


def test_the_curve_is_a_picture_and_on_a_page_with_the_next_commands(tmp_path: Path) -> None:
    epochs = tuple(epoch_of(number, loss) for number, loss in ((1, 0.3), (2, 0.125), (3, 0.2)))
    numbers = dict.fromkeys(("parameters", "train_episodes", "train_frames", "val_episodes", "val_frames"), 4)
    report = TrainReport(
        out="bc", finished=True, options=BcOptions(epochs=3), device="cpu", epochs=epochs, policy_epoch=2, **numbers
    )
    write_curve(tmp_path, report, ["factory eval 'my data' --policy bc:bc"])
    with Image.open(tmp_path / "curve.png") as picture:
        assert picture.size[0] > 800
        assert len(set(picture.convert("RGB").getdata())) > 50
    page = (tmp_path / "index.html").read_text()
    assert "The policy has the weights of epoch 2 of 3, with the smallest validation loss (0.125)" in page
    assert page.count("<svg") == 1  # no panel without values
    assert "2 (policy)" in page
    assert "factory eval &#39;my data&#39; --policy bc:bc" in page


@needs_torch
def test_the_policy_has_the_weights_of_its_epoch_also_after_an_interruption(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 4, splits=(Split.TRAIN_ID, Split.VAL_ID))
    chosen = options(epochs=6, peak_rate=0.1)
    for stop_after in (3, 99):
        train(tmp_path / "data", tmp_path / "out", chosen, stop_after)
    report = TrainReport.model_validate_json((tmp_path / "out" / "metrics.json").read_bytes())
    losses = [epoch.val_loss for epoch in report.epochs]
    assert None not in losses
    assert report.policy_epoch == 1 + losses.index(min(losses))
    train(tmp_path / "data", tmp_path / "until", chosen, report.policy_epoch)
    one, two = weights(tmp_path / "out"), weights(tmp_path / "until")
    assert all(np.array_equal(one[name], two[name]) for name in one)
    assert read_checkpoint(tmp_path / "out").meta.epochs_done == report.policy_epoch
