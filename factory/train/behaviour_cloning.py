"""Runs a training from a dataset to a folder: frames, epochs, checkpoints, logs. Resumes an interrupted training.

The folder contains `policy.pt` (used by `--policy bc:OUT`, with the weights of the epoch with the smallest validation
loss), `state.pt` (the state to resume from), `metrics.json` and `tensorboard/`. Checkpoints are written atomically
after an epoch. Defines no network and no loss.
"""

from __future__ import annotations

import importlib.metadata
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from factory.dataset.reader import Dataset
from factory.support.settings import cache_directory
from factory.train.checkpoint import (
    POLICY,
    STATE,
    Checkpoint,
    read_checkpoint,
    write_atomically,
    write_checkpoint,
)
from factory.train.frames import TrainingFrames, join_frames
from factory.train.measures import EpochMeasures, TrainReport
from factory.train.options import BcOptions, CheckpointMeta, TrainingStarts
from factory.train.pictures import open_cache, render_frames
from factory.train.torch_import import choose_device, deterministic_algorithms, load_torch, require_logs, summary_writer
from factory.train.vocabulary import vocabulary
from schemas.errors import UsageError, WorldError
from schemas.storage.disk import translated
from schemas.support.extras import require_package
from schemas.terms import Recording, Split
from workers.client.host_lock import sole_use

if TYPE_CHECKING:
    from factory.train.fit import BcTraining


_METRICS = "metrics.json"


@dataclass(frozen=True)
class TrainOrder:
    """Training request: dataset, output folder and limits, with the options that determine the result."""

    dataset: Dataset
    """Dataset, filtered by scene and tier if required, but not by split."""
    out: Path
    options: BcOptions
    split: Split = Split.TRAIN_ID
    device: str = "auto"
    minutes: float | None = None
    """Time limit, minutes: an epoch that would end later is not started. `None` means no limit."""
    corrections: tuple[Dataset, ...] = ()
    """Datasets of `factory correct`, whose episodes are added to those of the split."""
    memory_bytes: int = 2_000_000_000
    """Memory for the rendered frames of each split of a states dataset; does not change the result."""


@dataclass(frozen=True)
class TrainCallbacks:
    """Callbacks of a training."""

    caching: Callable[[int, int], None]
    """Called with the number of decoded episodes (of a states dataset: labelled episodes) and the total."""
    learning: Callable[[int, int, int, float], None]
    """Called with the number of finished epochs, the finished and total batches of the current epoch, and its loss."""
    measured: Callable[[EpochMeasures], None]
    is_stopped: Callable[[], bool]


class _EpochStopped(Exception):
    """The caller stopped the training within an epoch."""


@deterministic_algorithms()
def train_bc(order: TrainOrder, callbacks: TrainCallbacks) -> TrainReport:
    """Trains until all epochs are done, the time limit is reached or the caller stops it; resumes from the folder.

    Raises:
        UsageError: PyTorch is not installed, the folder contains a training with other options or episodes, or the
            split has no episodes.
        ArchiveCorrupt: An episode is damaged.
        WorldError: A file cannot be written, another training writes to the folder, or the loss is NaN.
    """
    device = choose_device(order.device)
    require_logs()
    require_package("matplotlib", "the curve of a training")
    with translated("write", order.out):
        order.out.mkdir(parents=True, exist_ok=True)
    with sole_use(order.out, "training"):
        return _train(order, callbacks, device, _former_state(order))


def _train(order: TrainOrder, callbacks: TrainCallbacks, device: Any, resumed: Checkpoint | None) -> TrainReport:
    train, val = frames_of_order(order, callbacks)
    meta = _meta(order, train)
    if resumed is not None:
        _require_same_data(resumed, meta, order.out)
    from factory.train.fit import BcTraining, TrainingLimits

    limits = TrainingLimits(meta.max_speed_mps, meta.max_yaw_rate_rps)
    training = BcTraining(order.options, meta.words, limits, device)
    epochs = _restore(order, training, resumed) if resumed is not None else []
    kept = _kept_epoch(order.out, epochs) if resumed is not None else None
    start_s, longest = time.monotonic(), 0.0
    with closing(summary_writer(str(order.out / "tensorboard"), training.epochs_done + 1)) as log:
        while training.epochs_done < order.options.epochs and not callbacks.is_stopped():
            spent = time.monotonic() - start_s
            if order.minutes is not None and longest and spent + longest > 60 * order.minutes:
                break

            def tell(done: int, of: int, loss: float) -> None:
                callbacks.learning(training.epochs_done, done, of, loss)
                if callbacks.is_stopped():
                    raise _EpochStopped

            try:
                measured = training.run_epoch(train, val, tell)
            except _EpochStopped:  # an epoch can take longer than a cluster waits after SIGTERM; it is repeated
                break
            _require_sound(measured)
            longest = max(longest, measured.seconds)
            epochs.append(measured)
            _log(log, measured)
            if is_better(measured, kept):
                kept = measured
            report = _report(order, training, train, val, epochs, kept, str(device))
            _write(order.out, training, meta, report, is_best=kept is measured)
            callbacks.measured(measured)
    return _report(order, training, train, val, epochs, kept, str(device))


def is_better(new: EpochMeasures, kept: EpochMeasures | None) -> bool:
    """Returns whether the weights of an epoch replace those of the epoch that is kept.

    The smallest validation loss decides; without one, the later epoch.
    """
    return kept is None or kept.val_loss is None or new.val_loss is None or new.val_loss < kept.val_loss


def _kept_epoch(out: Path, epochs: list[EpochMeasures]) -> EpochMeasures | None:
    """Returns the epoch whose weights `policy.pt` has, or `None` if it is later than the state.

    Such an epoch was interrupted between both files. It is done again, with the same weights.
    """
    number = read_checkpoint(out / POLICY).meta.epochs_done
    return next((epoch for epoch in epochs if epoch.epoch == number), None)


def _former_state(order: TrainOrder) -> Checkpoint | None:
    """Returns the training state in the folder, if any.

    Raises:
        UsageError: The training in the folder has other options.
    """
    checkpoint = read_checkpoint(order.out / STATE) if (order.out / STATE).exists() else None
    if checkpoint is not None:
        then, now = checkpoint.meta.options.model_dump(), order.options.model_dump()
        different = [f"{name} {then[name]}, now {now[name]}" for name in now if then[name] != now[name]]
        if different:
            raise UsageError(
                f"{order.out} contains a training with other options ({'; '.join(different)}): give the same options "
                "to continue it, or choose another --out"
            )
    return checkpoint


def _require_same_data(checkpoint: Checkpoint, meta: CheckpointMeta, out: Path) -> None:
    then = checkpoint.meta
    if (then.train_digest, then.words, then.appearance) != (meta.train_digest, meta.words, meta.appearance):
        raise UsageError(
            f"{out} contains a training on other episodes ({_describe_data(then)}; now {_describe_data(meta)}): "
            "give the same dataset, --correction, --split, --scene, --tier and --appearance to continue it, or choose "
            "another --out"
        )


def _describe_data(meta: CheckpointMeta) -> str:
    shown = "" if meta.appearance is None else f", appearance {meta.appearance.name}"
    return f"{meta.train_episodes} episodes, {meta.train_frames} frames, digest {meta.train_digest[:12]}{shown}"


def frames_of_order(order: TrainOrder, callbacks: TrainCallbacks) -> tuple[TrainingFrames, TrainingFrames | None]:
    """Returns the frames of a training, and those of its validation, if there are any.

    Raises:
        UsageError: The split has no episodes, or an option does not fit the dataset.
        ArchiveCorrupt: An episode is damaged.
    """
    options = order.options
    if options.antialias is not None and order.dataset.meta.plan.record is Recording.FRAMES:
        raise UsageError(f"--antialias {options.antialias}: {order.dataset.root} stores frames, which are not rendered")
    part = order.dataset.filter(split=order.split)
    if not len(part):
        splits = ", ".join(sorted(set(order.dataset.column("split").to_pylist()))) or "none"
        raise UsageError(
            f"{order.dataset.root} has no episodes in split {order.split} for this scene and tier; "
            f"splits with episodes: {splits}"
        )

    def tell(done: int, of: int) -> None:
        callbacks.caching(done, of)
        if callbacks.is_stopped():
            raise KeyboardInterrupt

    episodes = len(part) + sum(map(len, order.corrections))

    def frames_of(dataset: Dataset) -> TrainingFrames:
        if dataset.meta.plan.record is Recording.FRAMES:
            root = cache_directory() / "train"
            return open_cache(dataset, options.size, hold=options.hold, stops=options.stops, root=root, tell=tell)
        return render_frames(
            dataset,
            options.size,
            hold=options.hold,
            stops=options.stops,
            antialias=options.antialias,
            memory_bytes=order.memory_bytes * len(dataset) // max(len(dataset), episodes),
            tell=tell,
        )

    val = (
        order.dataset.filter(split=Split.VAL_ID) if order.split is not Split.VAL_ID else order.dataset.filter(split=())
    )
    train = join_frames([frames_of(part), *map(frames_of, order.corrections)])
    return train, frames_of(val) if len(val) else None


def _meta(order: TrainOrder, train: TrainingFrames) -> CheckpointMeta:
    index = train.index
    version = importlib.metadata.version("minivla-factory")
    return CheckpointMeta(
        options=order.options,
        words=vocabulary(episode.instruction for episode in index.episodes),
        control_hz=index.control_hz,
        fov_deg=index.fov_deg,
        max_speed_mps=index.max_speed_mps,
        max_yaw_rate_rps=index.max_yaw_rate_rps,
        train_digest=index.key.dataset,
        appearance=order.dataset.appearance,
        train_episodes=len(index.episodes),
        train_frames=len(train),
        starts=_starts((order.dataset.filter(split=order.split), *order.corrections)),
        software=f"minivla-factory {version}, torch {load_torch().__version__}",
    )


def _starts(datasets: Iterable[Dataset]) -> TrainingStarts:
    scenes: dict[str, dict[str, list[tuple[float, float, float]]]] = {}
    names = ("scene_sha256", "target_id", "spawn_x_m", "spawn_y_m", "spawn_yaw_rad")
    for dataset in datasets:
        for scene, target, *pose in zip(*(dataset.column(name).to_pylist() for name in names), strict=True):
            x, y, yaw = (round(value, 4) for value in pose)
            scenes.setdefault(scene, {}).setdefault(target, []).append((x, y, yaw))
    return TrainingStarts.model_validate({"scenes": scenes})


def _restore(order: TrainOrder, training: BcTraining, checkpoint: Checkpoint) -> list[EpochMeasures]:
    """Restores the state of the folder and returns the measures of its finished epochs."""
    try:
        training.restore(checkpoint.tensors)
        report = TrainReport.model_validate_json((order.out / _METRICS).read_bytes())
    except (KeyError, ValueError, RuntimeError, OSError, ValidationError) as error:
        first = (str(error).splitlines() or ["no reason given"])[0]
        raise WorldError(f"the training in {order.out} cannot be resumed ({first}): choose another --out") from error
    return [measured for measured in report.epochs if measured.epoch <= training.epochs_done]


def _require_sound(measured: EpochMeasures) -> None:
    if measured.train_loss != measured.train_loss:  # NaN
        raise WorldError(f"the loss of epoch {measured.epoch} is not a finite number: try a lower --rate")


def _write(out: Path, training: BcTraining, meta: CheckpointMeta, report: TrainReport, *, is_best: bool) -> None:
    done = meta.model_copy(update={"epochs_done": training.epochs_done})
    state = training.state()
    # the metrics are written first, because a resumed training discards epochs that are newer than its state
    write_atomically(out / _METRICS, report.model_dump_json(indent=2).encode())
    if is_best:
        write_checkpoint(out / POLICY, Checkpoint(done, {"model": _policy_weights(state["model"], meta.options)}))
    write_checkpoint(out / STATE, Checkpoint(done, state))


def _policy_weights(weights: dict[str, Any], options: BcOptions) -> dict[str, Any]:
    """Returns the weights of a policy; those of the larger network as float16, 10 MB, which is enough for inference."""
    if options.encoder == "residual":
        return weights
    return {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in weights.items()}


def _log(log: Any, measured: EpochMeasures) -> None:
    for name, value in measured.model_dump(exclude={"epoch"}).items():
        if value is not None:
            log.add_scalar(name, value, measured.epoch)
    log.flush()


def _report(
    order: TrainOrder,
    training: BcTraining,
    train: TrainingFrames,
    val: TrainingFrames | None,
    epochs: list[EpochMeasures],
    kept: EpochMeasures | None,
    device: str,
) -> TrainReport:
    return TrainReport(
        out=str(order.out),
        finished=training.epochs_done >= order.options.epochs,
        options=order.options,
        device=device,
        parameters=training.parameters,
        train_episodes=len(train.index.episodes),
        train_frames=len(train),
        val_episodes=len(val.index.episodes) if val else 0,
        val_frames=len(val) if val else 0,
        epochs=tuple(epochs),
        policy_epoch=None if kept is None else kept.epoch,
    )
