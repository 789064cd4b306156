"""Force that comes later than the pressure that makes it, or earlier: an error of stamps or buffers; arrays only.

The force of a muscle that is held follows its pressure within some hundredths of a second. Friction looks like a lag
on ramps, but not where the pressure stops or turns: there a late force goes on for as long as it is late.
"""

from __future__ import annotations

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers import motion
from pmabench.store.importers.effect import in_words, slope
from pmabench.store.importers.found import Bools, Checked, Report
from pmabench.store.records import Array

LEAST = 0.15
"""Less than this [s] is no doubt: tubes, filters and slow cells make it."""
MOST = 5.0
"""More is not looked for [s], nor more than an eighth of the file."""
PERIOD = 0.02
"""Samples nearer to each other are averaged [s] ..."""
POINTS = 20_000
"""... and so many at most are compared."""
SMOOTH = (5, 15, 50)
"""Points over which the rates of change are taken: the least for which force and pressure are alike."""
BETTER = 0.02
"""The correlation at the lag exceeds that at none by this."""
ALIKE = 0.5
"""Least correlation of the rates at the lag."""
GOES_ON = 0.4
"""Share of what force changed in one lag before a stop of the pressure that it changes in one lag after it."""
STOPS = 0.3
"""A stop or turn: the rate of the pressure falls below this share of what it was one lag before."""
MATTERS = 0.01
"""Change of the slope [1] from which on the values are withheld."""


def late(report: Report, force: Checked, pressure: Checked, good: Bools) -> bool:
    """Report where force lies later or earlier than pressure by more than 0.15 s, of what is `good`, shape (n,)."""
    rows = np.flatnonzero(good & motion.later(report.t))
    if len(rows) < 200:
        return False
    t = report.t[rows]
    usual = float(np.median(np.diff(t)))
    period = max(usual, PERIOD, float(t[-1] - t[0]) / POINTS)
    grid = np.arange(t[0], t[-1], period)
    F, P = (np.interp(grid, t, _averaged(channel.si[rows], period / usual)) for channel in (force, pressure))
    most = int(min(MOST / period, len(grid) / 8))
    if most < 3 or np.ptp(F) == 0 or np.ptp(P) == 0:
        return False
    seconds = _lag(F, P, most) * period
    if abs(seconds) < max(LEAST, 3.0 * period):
        return False
    shift = max(2, round(0.5 * abs(seconds) / period))  # half of it: another turn may follow
    first, second = (P, F) if seconds > 0 else (F, P)
    share = _goes_on(first, second, shift)
    if share is None or share < GOES_ON:
        return False
    moved = np.interp(report.t + seconds, t, force.si[rows])[rows]
    as_is, shifted = slope(pressure.si[rows], force.si[rows]), slope(pressure.si[rows], moved)
    change = as_is / shifted - 1.0 if as_is is not None and shifted else 0.0
    way = "later" if seconds > 0 else "earlier"
    text = f"follows {show(abs(seconds), 'time', 3)} {way} than the pressure that makes it"
    if as_is is not None and shifted is not None:
        text += f"; slope over pressure {in_words(as_is, 'force')} so, {in_words(shifted, 'force')} without the lag"
    if abs(change) > MATTERS:
        text += "; which stamps are right no rule can say: mend the times of one column, and import it again"
        report.withhold("lag", text, "force")
    else:
        report.add("doubt", "lag", text, "force")
    return True


def _averaged(values: Array, over: float) -> Array:
    """Mean of so many neighbours, shape (n,)."""
    width = max(1, round(over))
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.asarray(np.convolve(padded, np.ones(width) / width, mode="valid"))


def _lag(F: Array, P: Array, most: int) -> float:
    """By how many points `F` lies after `P`, both of shape (n,); 0 where that explains it no better."""
    shifts = np.arange(-most, most + 1)
    for smooth in SMOOTH:
        a, b = F[smooth:] - F[:-smooth], P[smooth:] - P[:-smooth]
        a, b = a - a.mean(), b - b.mean()
        size = 1 << (2 * len(a)).bit_length()
        together = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        alike = together[shifts] / (float(np.sqrt((a @ a) * (b @ b))) or 1.0)
        best = int(np.argmax(alike))
        if alike[best] >= ALIKE:
            return float(shifts[best]) if alike[best] >= alike[most] + BETTER else 0.0
    return 0.0


def _goes_on(first: Array, second: Array, shift: int) -> float | None:
    """Where `first` stops or turns: what `second` does in `shift` points after it, by what it did in those before."""
    before = np.concatenate([np.zeros(shift), first[shift:] - first[:-shift]])
    after = np.concatenate([first[shift:] - first[:-shift], np.zeros(shift)])
    large = np.abs(before) > 0.3 * float(np.max(np.abs(before)))
    stops = large & (np.sign(before) * after < STOPS * np.abs(before))
    stops[-shift:] = False
    shares = []
    for begin, end in motion.runs(stops):
        full = np.abs(before[begin:end])
        at = begin + int(np.flatnonzero(full >= 0.95 * full.max())[-1])  # the stop: the full rate ends here
        if at < shift or at + shift >= len(second):
            continue
        past = second[at] - second[at - shift]
        if past * before[at] <= 0 or abs(past) < 0.02 * np.ptp(second):
            continue
        shares.append(float((second[at + shift] - second[at]) / past))
    return float(np.median(shares)) if shares else None
