"""Renders the status pages: health and readiness for all clients, metrics for clients with the token, if one is set.

Metrics are in Prometheus' text format; all other modules avoid prometheus-client. The module opens no socket.
"""

from __future__ import annotations

import hmac
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from coordinator.meters import Meter
from coordinator.status.health import Snapshot, StatusSource
from coordinator.validation.sandbox import RLIMITS, SECCOMP
from schemas.protocol.status import Progress
from schemas.support.extras import missing_package

if TYPE_CHECKING:
    from prometheus_client.core import Metric

_COUNTERS = (
    (Meter.CLAIMS, "minivla_claims", "Jobs leased by this process."),
    (Meter.ARCHIVED, "minivla_archived", "Episodes archived by this process."),
    (Meter.PULLED_BYTES, "minivla_pull_bytes", "Bytes of bundles pulled by this process."),
    (Meter.PULLS_FAILED, "minivla_pulls_failed", "Failed transfers; they are repeated."),
    (Meter.REFUSED, "minivla_bundles_refused", "Bundles that failed validation."),
    (Meter.EXPIRED, "minivla_lease_expiries", "Leases that expired since this process started."),
)
_INDEX = "minivla-factory: /healthz /readyz /metrics\n"
_PLAIN = "text/plain; charset=utf-8"
Page = tuple[HTTPStatus, str, bytes]
"""HTTP status, content type and body."""


class Exposition:
    """Prometheus collector of one process.

    Args:
        snapshot: function that returns the metrics.

    Raises:
        UsageError: prometheus-client is not installed.
    """

    def __init__(self, snapshot: Callable[[], Snapshot]) -> None:
        try:
            import prometheus_client
            from prometheus_client import core
        except ImportError as error:
            raise missing_package("prometheus_client", "--http") from error
        self._snapshot = snapshot
        self._core: Any = core
        self._generate = prometheus_client.generate_latest
        self.content_type: str = prometheus_client.CONTENT_TYPE_LATEST
        """Content type of `page`."""
        self._registry = prometheus_client.CollectorRegistry()
        prometheus_client.ProcessCollector(registry=self._registry)
        self._registry.register(self)

    def page(self) -> bytes:
        """Returns the current metrics in Prometheus' text format."""
        return bytes(self._generate(self._registry))

    def describe(self) -> list[Metric]:
        """Returns no metric descriptions, so registration does not read the metrics."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yields all metrics; called by the registry."""
        snapshot = self._snapshot()
        if snapshot.progress is not None:
            yield from self._of_ledger(snapshot, snapshot.progress)
        yield from self._of_process(snapshot)

    def _of_ledger(self, snapshot: Snapshot, progress: Progress) -> Iterator[Metric]:
        yield self._gauges("minivla_jobs", "Episodes by the state of their current draw.", "state", progress.jobs)
        cells = {
            (scene, state): count for scene, states in progress.by_scene.items() for state, count in states.items()
        }
        by_scene = self._core.GaugeMetricFamily(
            "minivla_scene_jobs", "Episodes by scene and state of their current draw.", labels=("scene", "state")
        )
        for labels, count in cells.items():
            by_scene.add_metric(labels, count)
        yield by_scene
        yield self._gauge("minivla_episodes_planned", "Episodes of the plan.", progress.planned)
        yield self._gauge("minivla_episodes", "Episodes archived.", progress.jobs.get("archived", 0))
        kept = progress.by_gateway
        yield self._gauges("minivla_gateway_episodes", "Archived episodes that a gateway stores.", "gateway", kept)
        yield self._gauge("minivla_frames", "Frames archived.", snapshot.frames)
        yield self._gauges("minivla_attempts", "Attempts by outcome.", "outcome", progress.attempts)
        yield self._gauge("minivla_draws_given_up", "Draws replaced after their attempts failed.", progress.redrawn)
        alive = [worker for worker in progress.workers if worker.alive]
        yield self._gauge("minivla_workers_alive", "Workers with a heartbeat within one lease duration.", len(alive))
        yield self._gauge("minivla_slots_alive", "Simulation slots of those workers.", sum(w.slots for w in alive))
        if progress.episodes_per_hour is not None:
            yield self._gauge(
                "minivla_episodes_per_hour", "Rate of archived episodes over ten minutes.", progress.episodes_per_hour
            )
        if progress.eta_s is not None:
            yield self._gauge("minivla_eta_seconds", "Estimated remaining time at that rate.", progress.eta_s)
        yield self._gauge("minivla_finished", "1 if no job can change any more.", float(progress.finished))

    def _of_process(self, snapshot: Snapshot) -> Iterator[Metric]:
        requests = self._core.CounterMetricFamily("minivla_requests", "Requests by verb.", labels=("verb",))
        for verb, count in sorted(snapshot.requests.items()):
            requests.add_metric((verb,), count)
        yield requests
        for meter, name, text in _COUNTERS:
            yield self._core.CounterMetricFamily(name, text, value=snapshot.sums[meter])
        yield self._core.SummaryMetricFamily(
            "minivla_validation_seconds",
            "Wall time of validations.",
            count_value=snapshot.sums[Meter.VALIDATIONS],
            sum_value=snapshot.sums[Meter.VALIDATION_S],
        )
        yield self._gauge("minivla_disk_free_bytes", "Free space of the archive's disk.", snapshot.free_bytes)
        yield self._gauge(
            "minivla_disk_reserve_bytes", "Free space below which no job is leased.", snapshot.reserve_bytes
        )
        if snapshot.sandbox:
            active = {layer: int(layer in snapshot.sandbox) for layer in (RLIMITS, SECCOMP)}
            text = "1 if the sandbox layer is active in the validating processes."
            yield self._gauges("minivla_validator_sandbox", text, "layer", active)
        yield self._gauge("minivla_ledger_backlog", "Requests that wait for the ledger.", snapshot.backlog)

    def _gauge(self, name: str, text: str, value: float) -> Metric:
        family: Metric = self._core.GaugeMetricFamily(name, text, value=value)
        return family

    def _gauges(self, name: str, text: str, label: str, values: dict[str, int]) -> Metric:
        family: Any = self._core.GaugeMetricFamily(name, text, labels=(label,))
        for key, value in sorted(values.items()):
            family.add_metric((key,), value)
        metric: Metric = family
        return metric


class Pages:
    """Status pages of one process.

    Args:
        source: health and metrics of a coordinator or gateway.
        token: token that `/metrics` requires; `None` requires none.

    Raises:
        UsageError: the extra `metrics` is not installed.
    """

    def __init__(self, source: StatusSource, token: str | None) -> None:
        self._source = source
        self._token = token
        self._exposition = Exposition(source.snapshot)
        self._pages: dict[str, Callable[[], Page]] = {
            "/": lambda: (HTTPStatus.OK, _PLAIN, _INDEX.encode()),
            "/healthz": self._health,
            "/readyz": self._readiness,
            "/metrics": self._metrics,
        }

    def answer(self, path: str, authorization: str) -> Page:
        """Returns the page of a path. The call may block while the ledger is read."""
        page = self._pages.get(path)
        if page is None:
            return plain_page(HTTPStatus.NOT_FOUND, _INDEX)
        if path == "/metrics" and not self._is_authorised(authorization):
            return plain_page(HTTPStatus.UNAUTHORIZED, "a bearer token is required")
        return page()

    def _is_authorised(self, authorization: str) -> bool:
        wanted = f"Bearer {self._token}".encode()
        return self._token is None or hmac.compare_digest(authorization.encode("utf-8", "replace"), wanted)

    def _health(self) -> Page:
        if self._source.is_alive():
            return plain_page(HTTPStatus.OK, "ok")
        return plain_page(
            HTTPStatus.SERVICE_UNAVAILABLE, "the main thread of the coordinator has ended; restart the coordinator"
        )

    def _readiness(self) -> Page:
        troubles = self._source.troubles()
        if troubles:
            return plain_page(HTTPStatus.SERVICE_UNAVAILABLE, "\n".join(troubles))
        return plain_page(HTTPStatus.OK, "ready")

    def _metrics(self) -> Page:
        return HTTPStatus.OK, self._exposition.content_type, self._exposition.page()


def plain_page(status: HTTPStatus, text: str) -> Page:
    return status, _PLAIN, f"{text.rstrip()}\n".encode()
