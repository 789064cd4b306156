"""Whether the measured displacement of a driven end follows its command, in each trial alike.

A sensor whose scale or zero is changed, a mount that slips, or a drive that does not go where it is sent show in the
difference of both; the record does not say which.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import Any

import numpy as np

from pmabench.analysis.imported import import_of
from pmabench.analysis.shared.changes import SENT, TRAVEL, Change, cycles
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

MOVED = "displacement"
SCALE, PLACE = 2e-3, 2e-4
"""Changes of scale [1] and place [m] of the displacement, compared with the command, that are no change of a sensor."""
FAR, AWAY = 0.01, 1e-3
"""Constant differences of scale [1] and place [m] that are not reported."""
OTHER = 0.3
"""Difference of scale from which on the command counts as that of something else."""
CLEAR = 4.0
"""Usual differences between successive trials above which a difference is a change."""
BY_LAG = 0.5
"""Share of the effect of the drive's lag on the scale that its form leaves open."""
FEWEST = 20
"""Fewest samples of a trial."""


@dataclass(frozen=True, eq=False)
class Followed:
    """How the displacement follows its command in a cycle, or a half, of a trial."""

    trial: TrialData
    t: float
    """Its begin [s]."""
    centre: float
    """Mean of the command [m]."""
    place: float
    """Displacement minus command there [m]."""
    rest: float
    """What it differs from this by, rms [m]: more where it changes in between."""
    scale: float = nan
    """Share of the commanded travel that is measured [1]; nan where nothing travelled."""
    open: float = 0.0
    """What the lag of the drive leaves open of it [1]."""
    reach: float = 0.0
    """Half of the commanded travel [m]."""

    @classmethod
    def all_of(cls, trial: TrialData) -> Iterator[Followed]:
        """Of one trial."""
        if trial.status != "finished" or not {MOVED, SENT} <= set(trial.channels):
            return
        x, sent = trial.channels[MOVED], trial.channels[SENT]
        good = trial.usable & np.isfinite(x) & np.isfinite(sent)
        if np.count_nonzero(good) < FEWEST:
            return
        t, x, sent = trial.t[good], x[good], sent[good]
        speed = np.gradient(sent, t)
        for part in cycles(sent) or np.array_split(np.arange(len(t)), 2):
            if len(part) >= FEWEST // 2 and (one := cls.of(trial, t[part], x[part], sent[part], speed[part])):
                yield one

    @classmethod
    def of(cls, trial: TrialData, t: Array, x: Array, sent: Array, speed: Array) -> Followed | None:
        """Of a part of a trial; None where the command is that of something else."""
        centre, reach = float(sent.mean()), 0.5 * float(np.ptp(sent))
        if 2 * reach < TRAVEL:
            return cls(trial, float(t[0]), centre, float(np.median(x - sent)), float(np.std(x - sent)))
        # a drive that follows with a lag T is T times its speed behind; at a frequency w it also loses (w T)^2
        design = np.column_stack([np.ones_like(t), sent - centre, speed])
        terms, *_ = np.linalg.lstsq(design, x, rcond=None)
        scale, lag = float(terms[1]), float(terms[2] / terms[1])
        if abs(scale - 1) > OTHER:
            return None
        lost = lag**2 * float(np.mean(speed**2) / np.mean((sent - centre) ** 2))
        place, rest = float(terms[0]) - centre, float(np.std(x - design @ terms))
        return cls(trial, float(t[0]), centre, place, rest, scale * (1 + lost), BY_LAG * lost, reach)


def followed(run: RunData) -> Change | None:
    """Change of the displacement compared with its command within a run; of size 0 where it is off throughout."""
    every = [one for trial in run.trials for one in Followed.all_of(trial)]
    if not every:
        return None
    info, first = run.channels.get(MOVED), every[0]
    gain, offset = (0.0, 0.0) if info is None else (info.gain_uncertainty, info.offset_uncertainty)
    travelled = [one for one in every if isfinite(one.scale)]
    steady = travelled[0] if travelled else replace(first, scale=1 + _slope(every))
    most = max(SCALE, gain, CLEAR * _usual([one.scale for one in travelled]))
    far = max(PLACE, offset, CLEAR * _usual([one.place for one in every]))

    def before(sent: Any) -> Any:
        """Displacement minus command at the beginning of the run, where the drive is sent to [m]."""
        return first.place + (steady.scale - 1) * (sent - first.centre)

    moved = [one.place - before(one.centre) for one in every]
    changed = [one for one in travelled if abs(one.scale - steady.scale) > most + one.open + steady.open]
    slipped = [
        one for one, by in zip(every, moved, strict=True) if abs(by) > far + most * abs(one.centre - first.centre)
    ]
    if not changed and not slipped:
        return _constant(run, every, gain, steady)
    whole = CLEAR * float(np.median([one.rest for one in every]))
    size = [
        (one.rest <= whole, abs(by) + (abs(one.scale - steady.scale) * one.reach if one in changed else 0.0))
        if one in changed or one in slipped else (False, 0.0)
        for one, by in zip(every, moved, strict=True)
    ]  # fmt: skip
    place = max(range(len(every)), key=size.__getitem__)
    worst = every[place]
    by, offset = worst.scale - steady.scale if worst in changed else 0.0, moved[place]
    begun = min((*changed, *slipped), key=lambda one: one.t).trial
    x, sent = (np.nan_to_num(begun.channels[name]) for name in (MOVED, SENT))
    when = _since(begun.t, x - sent - before(sent), offset + by * (sent - worst.centre))
    scaled = f" by {by:+.1%} of the way that the drive was sent, and" if by else ""
    text = (
        f"{run.id}: from {when:.0f} s on, in trial {begun.number}, the displacement changed{scaled} by "
        f"{show(offset, 'length', 2)} at {show(worst.centre, 'length', 3)} compared with its command: the scale or the "
        "zero of its sensor, a mount that slipped, or a drive that does not go where it is sent. Look for the cause, "
        "and measure again"
    )
    return Change(MOVED, by, offset, worst.centre, text)


def _slope(every: Sequence[Followed]) -> float:
    """Change of what the displacement is off its command with the place, by the trials at three places and more."""
    centres, places = np.array([(one.centre, one.place) for one in every]).T
    return float(np.polyfit(centres, places, 1)[0]) if len(set(np.round(centres / TRAVEL))) > 2 else 0.0


def _usual(values: Sequence[float]) -> float:
    """Usual difference between successive values; a step changes two of them, where it is in the middle of one."""
    apart = np.sort(np.abs(np.diff(values)))[:-2]
    return float(np.median(apart)) if len(apart) else 0.0


def _since(t: Array, off: Array, size: Array) -> float:
    """Time [s] from which on `off` has the change `size`, all of shape (n,)."""
    gained = np.cumsum((2 * off * size - size * size)[::-1])[::-1]
    return float(t[int(np.argmax(gained))])


def _constant(run: RunData, every: Sequence[Followed], gain: float, steady: Followed) -> Change | None:
    """A change of size 0, that describes a displacement which differs from its command in all trials alike."""
    scales = [one.scale for one in every if isfinite(one.scale) and one.open < FAR] or [steady.scale]
    scale, place = float(np.median(scales)) - 1, float(np.median([one.place for one in every]))
    said = [f"{scale:+.1%} of the way that the drive was sent"] if abs(scale) > max(FAR, gain) else []
    said += [f"{show(place, 'length', 2)} off the place where it was sent"] if abs(place) > AWAY else []
    if not said or import_of(run):  # the zero and the sign of an imported command are not known
        return None
    return Change(
        MOVED, 0.0, 0.0, 0.0, f"{run.id}: the displacement reads {' and '.join(said)}: sensor or drive is wrong"
    )
