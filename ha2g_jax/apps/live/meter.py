"""Counts of a live run: latency, late and dropped frames, and the time of the computation."""

import numpy as np

_BINS = 10_000  # milliseconds; longer latencies count as the last


class Meter:
    """Counts of a run, in constant memory; one thread computes and another sends.

    Attributes:
        computed: frames that the model computed.
        sent: frames that were sent, at the rate of the sinks.
        late: sent frames that left more than a hop after their time.
        dropped: frames that were not sent, because they were more than a second late.
        compute_seconds: time of the computation.
        sound_seconds: seconds of sound that were heard.
        lost_seconds: seconds of sound that were lost, see `Source.lost_seconds`.
    """

    def __init__(self, stated: float) -> None:
        """Start without frames.

        Args:
            stated: latency in seconds without the time of the computation.
        """
        self.computed = self.sent = self.late = self.dropped = 0
        self.compute_seconds = self.sound_seconds = self.lost_seconds = 0.0
        self._stated = stated
        self._latencies = np.zeros(_BINS, np.int64)

    def count_latency(self, seconds: float) -> None:
        """Count the latency of a sent frame: the time from its moment of the sound to its departure."""
        self._latencies[min(max(round(1000 * seconds), 0), _BINS - 1)] += 1

    def latency(self, quantile: float) -> float | None:
        """Return a quantile of the latencies in seconds, to a millisecond; None before the first frame."""
        counts = np.cumsum(self._latencies)
        return None if counts[-1] == 0 else int(np.searchsorted(counts, quantile * counts[-1])) / 1000

    @property
    def real_time_factor(self) -> float:
        """Time of the computation per time of the sound; below 1 it keeps up."""
        return self.compute_seconds / max(self.sound_seconds, 1e-9)

    def line(self) -> str:
        """Return the meter as a line of text."""
        median, most = self.latency(0.5), self.latency(0.95)
        latency = (
            "" if median is None or most is None else f"latency {1000 * median:.0f} ms (95 %: {1000 * most:.0f}), "
        )
        lost = f", {self.lost_seconds:.1f} s of sound lost" if self.lost_seconds else ""
        return (
            f"{self.sound_seconds:.1f} s heard, {self.computed} frames, {latency}{self.late} late, "
            f"{self.dropped} dropped, {self.real_time_factor:.2f} of real time{lost}"
        )

    def summary(self) -> dict[str, float | int | None]:
        """Return the counts by name, in seconds."""
        return {
            "sound_seconds": round(self.sound_seconds, 3),
            "frames": self.computed,
            "sent": self.sent,
            "late": self.late,
            "dropped": self.dropped,
            "lost_seconds": round(self.lost_seconds, 3),
            "latency_stated": round(self._stated, 4),
            "latency_median": self.latency(0.5),
            "latency_95": self.latency(0.95),
            "real_time_factor": round(self.real_time_factor, 4),
        }
