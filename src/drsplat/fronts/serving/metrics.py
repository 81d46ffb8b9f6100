"""Metrics of the service, for Prometheus."""

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Gauge, Histogram, generate_latest

SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30)


class Metrics:
    """Counts of requests by route and status, their seconds, and how many compute or wait."""

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
            buckets=SECONDS,
            registry=self.registry,
        )
        self.computing = Gauge("drsplat_computing", "Requests that compute now", registry=self.registry)
        self.waiting = Gauge("drsplat_waiting", "Requests that wait to compute", registry=self.registry)

    def answered(self, route: str, status: int, seconds: float) -> None:
        self._requests.labels(route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        """Return the metrics in Prometheus' text format."""
        return bytes(generate_latest(self.registry))
