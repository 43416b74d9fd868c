"""What one way of synchronising says about two videos."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

MethodName = Literal["flash", "sound", "motion"]
METHODS: tuple[MethodName, ...] = ("flash", "sound", "motion")
"""In the order in which they are believed when they disagree."""
SURE = 0.3
"""Confidence below which an estimate counts less than any other."""


@dataclass(frozen=True)
class Estimate:
    """`offset` seconds added to the second video's time give the first's, at the second's time `when`.

    Both times count from each video's first frame. Clocks that differ make it grow by `drift` seconds per second
    (None: not known). `confidence` is in [0, 1]; what it is made of, the method says. `detail` is for the report.
    """

    method: MethodName
    offset: float
    confidence: float
    when: float
    drift: float | None = None
    detail: Mapping[str, Any] = field(default_factory=dict)

    def at(self, when: float) -> float:
        """The offset at another time of the second video, seconds."""
        return self.offset + (self.drift or 0.0) * (when - self.when)


class Undecided(Exception):
    """A method cannot decide; the message is a clause that says why, and names the video where one is to blame."""
