"""Metrics of the service, for Prometheus."""

from collections.abc import Sequence

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Gauge, Histogram, generate_latest

ANSWER_BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30)
VIEW_BUCKETS_S = (0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600)


class Metrics:
    """Counts of requests by route and status, their seconds, how many compute or wait; and views that were sent."""

    content_type = CONTENT_TYPE_LATEST

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._requests = Counter(
            "drsplat_requests_total", "Requests answered", ("route", "status"), registry=self.registry
        )
        self._seconds = Histogram(
            "drsplat_request_seconds",
            "From the first byte to the answer",
            ("route",),
            buckets=ANSWER_BUCKETS_S,
            registry=self.registry,
        )
        self.computing = Gauge("drsplat_computing", "Requests that compute now", registry=self.registry)
        self.waiting = Gauge("drsplat_waiting", "Requests that wait to compute", registry=self.registry)

        self._views = Counter(
            "drsplat_views_total", "Views that were sent, by what became of them", ("outcome",), registry=self.registry
        )
        self._view_seconds = Histogram(
            "drsplat_view_seconds",
            "From the arrival of a view to being in the field",
            buckets=VIEW_BUCKETS_S,
            registry=self.registry,
        )
        self.views_waiting = Gauge("drsplat_views_waiting", "Views that wait to be added", registry=self.registry)

    def view_taken(self) -> None:
        self._views.labels("taken").inc()

    def views_done(self, seconds: Sequence[float], num_refused: int) -> None:
        """Count views that were added, by their seconds, and views that were refused."""
        self._views.labels("added").inc(len(seconds))
        self._views.labels("refused").inc(num_refused)
        for one in seconds:
            self._view_seconds.observe(one)

    def answered(self, route: str, status: int, seconds: float) -> None:
        self._requests.labels(route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        """Return the metrics in Prometheus' text format."""
        return bytes(generate_latest(self.registry))
