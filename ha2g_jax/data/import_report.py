"""Report of an import: counts of what was kept and of what was left out, by reason."""

import collections
import dataclasses
from typing import Any, TypeAlias


@dataclasses.dataclass
class SplitReport:
    """Counts of one split; the sum of two reports is a report.

    Attributes:
        videos: number of recordings read: videos, motion captures or entries of a database.
        clips: number of clips that the recordings have, or that were cut from them.
        windows: number of windows examined.
        kept: number of windows that passed all filters.
        filtered: number of windows that failed a filter, by reason.
        rejected: number of clips or shots without any window, by reason.
    """

    videos: int = 0
    clips: int = 0
    windows: int = 0
    kept: int = 0
    filtered: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    rejected: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)

    def __add__(self, other: "SplitReport") -> "SplitReport":
        return SplitReport(
            self.videos + other.videos,
            self.clips + other.clips,
            self.windows + other.windows,
            self.kept + other.kept,
            _sum(self.filtered, other.filtered),
            _sum(self.rejected, other.rejected),
        )

    def as_json(self) -> dict[str, Any]:
        """Return the counts ready for JSON; "rejected" only if a clip was rejected."""
        counts = dataclasses.asdict(self) | {"filtered": dict(self.filtered), "rejected": dict(self.rejected)}
        return counts if self.rejected else {name: count for name, count in counts.items() if name != "rejected"}

    @classmethod
    def from_json(cls, counts: dict[str, Any]) -> "SplitReport":
        """Make a report of counts that `as_json` returned.

        Raises:
            AttributeError, TypeError, ValueError: `counts` is no dict, has other keys, or values that are not counts.
        """
        filtered, rejected = (collections.Counter(dict(counts.get(name, {}))) for name in ("filtered", "rejected"))
        report = cls(**{**counts, "filtered": filtered, "rejected": rejected})
        simple = (report.videos, report.clips, report.windows, report.kept)
        for count in (*simple, *filtered.values(), *rejected.values()):
            if type(count) is not int or not 0 <= count < 2**63:
                raise ValueError(f"a count of {repr(count)[:60]}")
        return report


Report: TypeAlias = dict[str, SplitReport]


def as_json(report: Report) -> dict[str, Any]:
    """Return the counts of each split, ready for JSON."""
    return {split: counts.as_json() for split, counts in report.items()}


def as_table(report: Report) -> str:
    """Format a report as text: one line per split, followed by one line per reason."""
    lines = [f"{'split':<12}{'videos':>8}{'clips':>8}{'windows':>10}{'kept':>10}"]
    for split, counts in report.items():
        lines.append(f"{split:<12}{counts.videos:>8}{counts.clips:>8}{counts.windows:>10}{counts.kept:>10}")
        lines += [f"  {count} windows left out: {reason}" for reason, count in counts.filtered.items() if count]
        lines += [f"  {count} clips left out: {reason}" for reason, count in counts.rejected.items() if count]
    return "\n".join(lines)


def _sum(first: collections.Counter[str], second: collections.Counter[str]) -> collections.Counter[str]:
    # Counter's own + drops reasons with a count of 0.
    return collections.Counter({name: first[name] + second[name] for name in dict.fromkeys([*first, *second])})
