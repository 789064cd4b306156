"""Effect of the calibration uncertainties of channels on a result, to first order.

A calibration gives two expanded uncertainties (95 %, k = 2), independent of each other: an offset, the same at every
reading [SI of the channel], and a gain, a share of the reading: true value = (1 + gain) reading + offset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from dataclasses import dataclass, replace
from math import hypot, sqrt

from pmabench.store.analyses.results import Estimate, Finding
from pmabench.store.records import RunData

Sensitivities = Mapping[str, float]
"""Channel -> derivative of a result by its gain or offset."""
Values = Mapping[str, float | None]
"""Symbol -> value; None where there is none."""
NOT_DECLARED = "calibration part: the record gives no"
"""Text in a note about a channel whose uncertainty is not in the calibration part."""

HYSTERESIS = 1 / 3
"""Share of the uncertainty of a sensor's offset that may be hysteresis, from data sheets: the rest is drift of its zero
and non-linearity."""


@dataclass(frozen=True)
class Scales:
    """Expanded uncertainties by channel, the largest of several runs; only channels for which every run gives it."""

    offsets: Mapping[str, float]
    """[SI of the channel]."""
    gains: Mapping[str, float]
    """[1]."""

    @classmethod
    def of(cls, runs: Iterable[RunData]) -> Scales:
        """Uncertainties of the channels of runs; a channel that one run did not record counts as unknown."""
        infos = [run.channels for run in runs]
        names = [name for name in (infos[0] if infos else ()) if all(name in info for info in infos)]

        def worst(of: str) -> dict[str, float]:
            known = {name: [float(getattr(info[name], of)) for info in infos] for name in names}
            return {name: max(values) for name, values in known.items() if min(values) > 0}

        return cls(worst("offset_uncertainty"), worst("gain_uncertainty"))

    def part(self, gains: Sensitivities, offsets: Sensitivities | None = None) -> float | None:
        """Half width of a result from the calibrations, root of the sum of squares; None where no uncertainty is known.

        `gains`: derivatives of the result by the channels' gains [1]; `offsets`: by their offsets [SI].
        """
        offsets = offsets or {}
        if (gains or offsets) and len(self._missing(gains, offsets)) == len({*gains, *offsets}):
            return None
        by_gain = sum((self.gains.get(name, 0.0) * change) ** 2 for name, change in gains.items())
        return sqrt(by_gain + sum((self.offsets.get(name, 0.0) * change) ** 2 for name, change in offsets.items()))

    def part_at(
        self, pressure: float, over_P: float | None, gains: Sensitivities, offsets: Sensitivities
    ) -> float | None:
        """As `part`, for a value at a set `pressure` [Pa] with derivative `over_P` [1/Pa], which may be unknown.

        Channels with a derivative of 0 do not count as unknown.
        """
        if over_P is not None:
            gains, offsets = {**gains, "pressure": over_P * pressure}, {**offsets, "pressure": over_P}
        return self.part(*({name: change for name, change in one.items() if change} for one in (gains, offsets)))

    def lack(self, gains: Iterable[str], offsets: Iterable[str] = ()) -> str:
        """Note that names the channels of `part` without a recorded uncertainty; empty if there are none."""
        gains, offsets = list(gains), list(offsets)
        missing = self._missing(gains, offsets)
        if not missing:
            return ""
        kind = "uncertainty" if set(missing) <= set(offsets) else "gain uncertainty"
        whole = len(missing) == len({*gains, *offsets})
        return f"{'no' if whole else 'incomplete'} {NOT_DECLARED} {kind} of {listed(missing)}"

    def findings(self, results: Sized, gains: Iterable[str], offsets: Iterable[str] = ()) -> list[Finding]:
        """The text of `lack` as a note, where there are results and a channel lacks its uncertainty."""
        lack = self.lack(gains, offsets)
        return [Finding("note", lack)] if results and lack else []

    def _missing(self, gains: Iterable[str], offsets: Iterable[str]) -> list[str]:
        """Channels with no known uncertainty."""
        known = {*(set(gains) & set(self.gains)), *(set(offsets) & set(self.offsets))}
        return [name for name in dict.fromkeys((*gains, *offsets)) if name not in known]


def changes(now: Values, *others: Values) -> dict[str, float]:
    """Largest absolute difference of each value from those of `others`; 0 where none is known."""
    pairs = {name: [(value, other[name]) for other in others] for name, value in now.items()}
    return {
        name: max((abs(a - b) for a, b in both if a is not None and b is not None), default=0.0)
        for name, both in pairs.items()
    }


def of_one_channel(
    values: Callable[[float, float], Values], now: Values, scales: Scales, channel: str
) -> dict[str, float] | None:
    """Half widths of several values from one channel's calibration, by recomputing them; None where it is unknown.

    `values(offset, gain)` gives the values with the offset [SI] and gain [1] changed. The larger change of both signs
    counts, and offset and gain add as squares.
    """
    offset, gain = scales.offsets.get(channel, 0.0), scales.gains.get(channel, 0.0)
    causes = [(more, share) for more, share in ((offset, 0.0), (0.0, gain)) if more or share]
    each = [changes(now, values(-more, -share), values(more, share)) for more, share in causes]
    return {name: hypot(*(one[name] for one in each)) for name in now} if each else None


def calibrated(e: Estimate, scales: Scales, gains: Sensitivities, offsets: Sensitivities) -> Estimate:
    """The estimate with the calibration part of `Scales.part`, or with a note that names what is not recorded."""
    part = scales.part(gains, offsets)
    lack = "" if part is not None else scales.lack(gains, offsets)
    return replace(e, parts=replace(e.parts, calibration=part), note=sentences(e.note, lack))


def listed(names: Sequence[str]) -> str:
    """Names as text: `a, b and c`."""
    return ", ".join(names[:-1]) + (" and " if names[:-1] else "") + names[-1]


def sentences(*parts: str) -> str:
    """Texts without repeats and empty ones, joined to one note."""
    return "; ".join(part for part in dict.fromkeys(parts) if part)
