"""What an import kept and what it left out, with the reason of each."""

import collections
import dataclasses
from typing import Any, TypeAlias


@dataclasses.dataclass
class SplitReport:
    """Counts of one split; two of them add up.

    Attributes:
        videos: recordings read, each a talk: videos, motion captures or records of a database.
        clips: pieces that the source has, or that were cut from it.
        windows: stretches of a clip that were looked at.
        kept: windows that passed.
        filtered: windows that did not, by reason.
        rejected: clips or shots that gave no window at all, by reason.
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
        """The counts; "rejected" only where something was."""
        counts = dataclasses.asdict(self) | {"filtered": dict(self.filtered), "rejected": dict(self.rejected)}
        return counts if self.rejected else {name: count for name, count in counts.items() if name != "rejected"}

    @classmethod
    def from_json(cls, counts: dict[str, Any]) -> "SplitReport":
        """What `as_json` gave.

        Raises:
            TypeError: `counts` is something else.
        """
        filtered, rejected = (collections.Counter(counts.get(name, {})) for name in ("filtered", "rejected"))
        return cls(**{**counts, "filtered": filtered, "rejected": rejected})


Report: TypeAlias = dict[str, SplitReport]


def as_json(report: Report) -> dict[str, Any]:
    """Split -> its counts, ready for JSON."""
    return {split: counts.as_json() for split, counts in report.items()}


def as_table(report: Report) -> str:
    """One line a split, and one for each reason under it."""
    lines = [f"{'split':<12}{'videos':>8}{'clips':>8}{'windows':>10}{'kept':>10}"]
    for split, counts in report.items():
        lines.append(f"{split:<12}{counts.videos:>8}{counts.clips:>8}{counts.windows:>10}{counts.kept:>10}")
        lines += [f"  {count} windows left out: {reason}" for reason, count in counts.filtered.items() if count]
        lines += [f"  {count} clips left out: {reason}" for reason, count in counts.rejected.items() if count]
    return "\n".join(lines)


def _sum(first: collections.Counter[str], second: collections.Counter[str]) -> collections.Counter[str]:
    # Counter's own + drops the reasons that never occurred.
    return collections.Counter({name: first[name] + second[name] for name in dict.fromkeys([*first, *second])})
