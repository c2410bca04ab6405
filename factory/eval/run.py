"""A whole evaluation on one machine: policies x variants x episodes over driving processes, kept as they finish.

Owns the processes and ends them all when it ends; prints nothing, a listener is told.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from coordinator.dataset_meta import software_versions
from factory.eval.ablation import donors, instructions
from factory.eval.from_dataset import Places
from factory.eval.message import Order, Report, ReportKind, Setup
from factory.eval.policies import find_policy
from factory.eval.policy import PolicyFault
from factory.eval.result import EpisodeResult, EvalEnd, Variant
from factory.eval.rollout import Question, describe_question, progresses
from factory.eval.seat import Ended, Seat
from factory.eval.spec import SpecSet
from factory.eval.store import PolicyNote, Store
from schemas.errors import UsageError, WorldError

__all__ = ["Campaign", "Pace", "orders_for", "require_recordings", "run_campaign"]

_POLL_S = 0.05
_TRIES = 2
"""How often an episode is begun when the simulation, not the policy, dies."""


@dataclass(frozen=True)
class Campaign:
    """What to evaluate, and with what."""

    specs: SpecSet
    root: Path
    """The dataset, which has the scenes."""
    policies: tuple[str, ...]
    variants: tuple[Variant, ...]
    setup: Setup
    processes: int = 1


@dataclass(frozen=True)
class Pace:
    """How far a campaign is."""

    policy: str
    done: int
    """Of the policy, earlier runs included."""
    total: int
    successes: int


Tell = Callable[[Pace], None]


def run_campaign(campaign: Campaign, store: Store, stop: threading.Event, tell: Tell) -> bool:
    """Drives every episode that is not finished yet; returns whether all are done, or `stop` was set before.

    Args:
        campaign: what to do.
        store: holds the finished episodes and takes the new ones.
        stop: leave at once; nothing finished is lost.
        tell: told after every episode.

    Raises:
        UsageError: a policy cannot be made, or the specs do not fit the dataset.
        WorldError: a policy's server is away, or simulations die.
    """
    places = Places(campaign.root)
    with ExitStack() as stack:
        seats = [Seat(campaign.setup) for _ in range(campaign.processes)]
        for seat in seats:
            stack.callback(seat.kill)
        for policy in campaign.policies:
            if not _Round(campaign, orders_for(campaign, policy, places), store, seats, stop, tell).run():
                return False
    return True


def orders_for(campaign: Campaign, policy: str, places: Places) -> list[Order]:
    """Returns all episodes of a policy in the order of work: by variant, scene and place in the set."""
    entry = find_policy(policy)
    specs = campaign.specs
    packages = {spec.scene_sha256: places.path(spec.scene, spec.scene_sha256) for spec in specs.specs}
    # a policy that cannot hear is not asked again under other words
    variants = campaign.variants if entry.reads_instruction else (Variant.ORIGINAL,)
    needs_scenes = Variant.WRONG in variants
    scenes = {
        spec.scene_sha256: places.load(spec.scene, spec.scene_sha256).scene.info for spec in specs.specs if needs_scenes
    }
    recorded = _recordings(policy, specs) if entry.needs_recording else {}
    orders: list[Order] = []
    for variant in variants:
        words = instructions(specs, variant, scenes)
        for spec in sorted(specs.specs, key=lambda spec: spec.scene):
            orders.append(
                Order(
                    number=len(orders),
                    policy=policy,
                    spec=spec,
                    spec_digest=specs.spec_digest(spec),
                    package=packages[spec.scene_sha256],
                    variant=variant,
                    instruction=words[spec.spec_id],
                    recorded=recorded.get(spec.spec_id),
                )
            )
    return orders


def require_recordings(policy: str, specs: SpecSet) -> None:
    """Makes sure that all specs come from archived episodes.

    Raises:
        UsageError: one does not.
    """
    lacking = [spec.spec_id for spec in specs.specs if spec.source_episode is None]
    if lacking:
        raise UsageError(f"policy {policy} needs specs of archived episodes; {lacking[0]} is freshly drawn")


def _recordings(policy: str, specs: SpecSet) -> dict[str, str]:
    require_recordings(policy, specs)
    if policy == "playback":
        return donors(specs)
    return {spec.spec_id: spec.source_episode for spec in specs.specs if spec.source_episode is not None}


class _Round:
    """All episodes of one policy."""

    def __init__(
        self,
        campaign: Campaign,
        orders: list[Order],
        store: Store,
        seats: list[Seat],
        stop: threading.Event,
        tell: Tell,
    ) -> None:
        self._campaign, self._orders, self._store = campaign, orders, store
        self._policy = orders[0].policy
        self._seats, self._stop, self._tell = seats, stop, tell
        self._renderer = ""
        self._is_made = False
        self._deaths: dict[int, int] = {}

    def run(self) -> bool:
        """Returns whether all are done."""
        orders = self._orders
        finished = self._store.results(self._policy)
        done = {(result.spec_id, result.variant, result.instruction) for result in finished}
        waiting = deque(o for o in orders if (o.spec.spec_id, o.variant, o.instruction) not in done)
        wanted = {(o.spec.spec_id, o.variant) for o in orders}
        kept = [result for result in finished if (result.spec_id, result.variant) in wanted]
        pace = Pace(self._policy, len(orders) - len(waiting), len(orders), sum(result.success for result in kept))
        self._tell(pace)
        while pace.done < pace.total and not self._stop.is_set():
            for result in self._turns(waiting):
                self._store.add(result)
                pace = Pace(self._policy, pace.done + 1, pace.total, pace.successes + result.success)
                self._tell(pace)
        return pace.done >= pace.total

    def _turns(self, waiting: deque[Order]) -> Iterator[EpisodeResult]:
        """Gives every idle seat an order and hears every busy one once."""
        busy = 0
        for seat in self._seats:
            if seat.order_at_hand is None and waiting:
                seat.give(waiting.popleft())
            busy += seat.order_at_hand is not None
        for seat in self._seats:
            if seat.order_at_hand is None:
                continue
            heard = seat.hear(_POLL_S / max(1, busy))
            result = self._after_end(seat, heard, waiting) if isinstance(heard, Ended) else self._after(heard)
            if result is not None:
                seat.order_at_hand = None
                yield result

    def _after(self, report: Report | None) -> EpisodeResult | None:
        if report is None:
            return None
        if report.kind is ReportKind.READY:
            self._renderer = report.detail
        elif report.kind is ReportKind.POLICY:
            self._is_made = True
            self._note(report.detail)
        elif report.kind is ReportKind.REFUSED:
            raise UsageError(report.detail) if report.exit_code == 2 else WorldError(report.detail)
        elif report.kind is ReportKind.AWAY:
            kept = f"results so far are kept in {self._store.root}"
            raise WorldError(f"{report.detail}; {kept}: start the server and run the same command again")
        elif report.kind is ReportKind.DEFECT:
            raise RuntimeError(f"a driving process broke: {report.detail}")
        return report.result

    def _after_end(self, seat: Seat, ended: Ended, waiting: deque[Order]) -> EpisodeResult | None:
        order = seat.order_at_hand
        if order is None:
            return None
        if ended.fault is not None and self._is_made:
            return _result_of_end(order, ended, ended.fault, self._campaign)
        if ended.fault is not None:
            raise WorldError(f"policy {order.policy} cannot be made: {ended.detail}")
        self._deaths[order.number] = self._deaths.get(order.number, 0) + 1
        if self._deaths[order.number] >= _TRIES:
            raise WorldError(f"{order.spec.spec_id}: the simulation failed {_TRIES} times: {ended.detail}")
        seat.order_at_hand = None
        waiting.appendleft(order)
        return None

    def _note(self, knows: str) -> None:
        if self._store.note_of(self._policy) is None:
            self._store.note(
                PolicyNote(
                    policy=self._policy,
                    knows=knows,
                    reads_instruction=find_policy(self._policy).reads_instruction,
                    renderer=self._renderer,
                    software=software_versions(),
                )
            )


def _result_of_end(order: Order, ended: Ended, fault: PolicyFault, campaign: Campaign) -> EpisodeResult:
    """The result of an episode whose process had to be ended: measured by what stood on its sheet, worth nothing."""
    spec, state, task = order.spec, ended.state, campaign.specs.settings.task
    start_m = state.start_m or spec.spawn_dist_m
    now_m, least_m = (state.now_m, state.least_m) if state.start_m else (start_m, start_m)
    question = Question(spec, order.spec_digest, order.instruction, order.variant)
    nothing = None if spec.geodesic_m is None else 0.0
    return EpisodeResult(
        **describe_question(question, order.policy),
        end=EvalEnd(fault),
        detail=ended.detail,
        success=False,
        any_instance=False,
        num_steps=state.steps,
        spawn_dist_m=start_m,
        trajectory_length_m=state.driven_m,
        final_ne_m=now_m,
        min_ne_m=least_m,
        spl=nothing,
        soft_spl=nothing,
        **progresses(start_m, now_m, least_m, task),
        contact_steps=state.contact_steps,
        clipped_actions=0,
        act_ms=0.0,
        seconds=0.0,
        track=(spec.spawn_pose,),
    )
