"""Metrics of the service, for Prometheus."""

from collections.abc import Sequence
from typing import Any

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Gauge, Histogram, generate_latest

ANSWER_BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30)
VIEW_BUCKETS_S = (0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600)


class Metrics:
    """Counts of requests by route and status, their seconds, how many compute or wait; and views that were sent."""

    content_type = CONTENT_TYPE_LATEST

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        own: dict[str, Any] = {"registry": self.registry}
        self._requests = Counter("drsplat_requests_total", "Requests answered", ("route", "status"), **own)
        told = "From the first byte to the answer"
        self._seconds = Histogram("drsplat_request_seconds", told, ("route",), buckets=ANSWER_BUCKETS_S, **own)
        self.computing = Gauge("drsplat_computing", "Requests that compute now", **own)
        self.waiting = Gauge("drsplat_waiting", "Requests that wait to compute", **own)
        told = "Views that were sent, by what became of them"
        self.views = Counter("drsplat_views_total", told, ("outcome",), **own)
        told = "From the arrival of a view to being in the field"
        self._view_seconds = Histogram("drsplat_view_seconds", told, buckets=VIEW_BUCKETS_S, **own)
        self.views_waiting = Gauge("drsplat_views_waiting", "Views that wait to be added", **own)

    def views_done(self, seconds: Sequence[float], num_refused: int) -> None:
        """Count views that were added, by their seconds, and views that were refused."""
        self.views.labels("added").inc(len(seconds))
        self.views.labels("refused").inc(num_refused)
        for one in seconds:
            self._view_seconds.observe(one)

    def answered(self, route: str, status: int, seconds: float) -> None:
        self._requests.labels(route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        """Return the metrics in Prometheus' text format."""
        return bytes(generate_latest(self.registry))
