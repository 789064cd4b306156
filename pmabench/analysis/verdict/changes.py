"""What another calibration of the same samples makes of every coefficient: before, after, difference; fits nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any

from pmabench.analysis.results import Analysis, Estimate


@dataclass(frozen=True)
class Change:
    """One coefficient on both sides; None where one side does not have it at all."""

    kind: str
    runs: tuple[str, ...]
    before: Estimate | None
    after: Estimate | None

    @property
    def estimate(self) -> Estimate:
        """The one of the two that there is, the newer first."""
        found = self.after or self.before
        assert found is not None  # noqa: S101
        return found

    @property
    def difference(self) -> float | None:
        """After less before [SI]; None where one of them has no value."""
        if self.before is None or self.after is None or self.before.value is None or self.after.value is None:
            return None
        return self.after.value - self.before.value

    @property
    def half_width(self) -> float | None:
        """95 % half width of the difference [SI]; None where a calibration part was not assessed.

        The same samples stand behind both values, so repeats and method cancel; what is left is how well each of the
        two calibrations is known, taken as independent. Where both rest on one reference it is less.
        """
        if self.difference is None or self.before is None or self.after is None:
            return None
        one, other = self.before.parts.calibration, self.after.parts.calibration
        return None if one is None or other is None else hypot(one, other)

    def to_dict(self) -> dict[str, Any]:
        """The documented JSON object of a change."""
        e = self.estimate
        return {
            "kind": self.kind,
            "symbol": e.symbol,
            "coordinate": e.coordinate,
            "at": dict(e.at),
            "method": e.method,
            "unit": e.unit,
            "quantity": e.quantity,
            "before": _side(self.before),
            "after": _side(self.after),
            "difference": self.difference,
            "half_width": self.half_width,
        }


def _side(estimate: Estimate | None) -> dict[str, Any] | None:
    if estimate is None:
        return None
    ends = estimate.ci95
    return {"value": estimate.value, "ci95": None if ends is None else list(ends), "note": estimate.note}


def changes(before: Sequence[Analysis], after: Sequence[Analysis]) -> list[Change]:
    """Every coefficient of either side, in the order of `after`, then those that only `before` has.

    Analyses belong together by kind and runs, coefficients by symbol, method and operating point; points that were
    measured are the same to 1e-6 of them only by chance, so they are also taken in their order where they differ.
    """
    found: list[Change] = []
    sides = {(analysis.kind, analysis.runs): analysis.estimates for analysis in before}
    for analysis in after:
        left = list(sides.pop((analysis.kind, analysis.runs), ()))
        pairs = [(estimate, _take(left, estimate)) for estimate in analysis.estimates]
        found += [
            Change(analysis.kind, analysis.runs, other or _take(left, estimate, exact=False), estimate)
            for estimate, other in pairs
        ]
        found += [Change(analysis.kind, analysis.runs, other, None) for other in left]
    found += [Change(kind, runs, other, None) for (kind, runs), estimates in sides.items() for other in estimates]
    return found


def _take(left: list[Estimate], estimate: Estimate, *, exact: bool = True) -> Estimate | None:
    """The estimate of the same coefficient, taken out of `left`."""
    for index, other in enumerate(left):
        same = (other.symbol, other.coordinate, other.method, tuple(other.at)) == (
            estimate.symbol,
            estimate.coordinate,
            estimate.method,
            tuple(estimate.at),
        )
        if same and (not exact or all(abs(other.at[k] - v) <= 1e-6 * abs(v) for k, v in estimate.at.items())):
            return left.pop(index)
    return None
