"""What the service counts, in the form of Prometheus."""

import os

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.multiprocess import MultiProcessCollector

FOLDER = "PROMETHEUS_MULTIPROC_DIR"  # variable of prometheus_client: folder in which workers share their values

_MOTION_SECONDS = (0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)
_FEED_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.04, 0.0667, 0.1, 0.2, 0.5, 1)


class Counters:
    """Counters of one service; where there are several workers, the sums over them.

    Attributes:
        requests: requests and streams that were answered, by route and status; a stream that begins has status 101.
        motion_seconds: time from the upload of sound to its motion.
        feed_seconds: time of the computation for one piece of sound of a stream, at most 0.2 s of sound.
        frames: frames sent in streams.
        errors: streams that ended with an error, by the code of the close.
        running: requests for motion that are running.
        sessions: streams that are running.
        workers: processes that take requests.
    """

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        labels = ("route", "status")
        self.requests = Counter("ha2g_requests", "Requests answered", labels, registry=registry)
        self.motion_seconds = Histogram(
            "ha2g_motion_seconds", "Time to generate a motion", buckets=_MOTION_SECONDS, registry=registry
        )
        self.feed_seconds = Histogram(
            "ha2g_feed_seconds",
            "Computation for a piece of sound of a stream",
            buckets=_FEED_SECONDS,
            registry=registry,
        )
        self.frames = Counter("ha2g_frames", "Frames sent in streams", registry=registry)
        self.errors = Counter("ha2g_stream_errors", "Streams ended with an error", ("code",), registry=registry)
        self.running = self._gauge("ha2g_requests_running", "Requests for motion that are running")
        self.sessions = self._gauge("ha2g_sessions", "Streams that are running")
        self.workers = self._gauge("ha2g_workers", "Processes that take requests")

    def _gauge(self, name: str, text: str) -> Gauge:
        """Return a gauge that is summed over the processes that run."""
        return Gauge(name, text, registry=self._registry, multiprocess_mode="livesum")

    def text(self) -> bytes:
        """Return all values in the text form of Prometheus."""
        if FOLDER not in os.environ:
            return generate_latest(self._registry)
        registry = CollectorRegistry()
        MultiProcessCollector(registry)
        return generate_latest(registry)
