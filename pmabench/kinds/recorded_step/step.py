"""One recorded step of pressure: onset and rise of the pressure, and the motion that it drives.

Evaluates one trial with one command from its samples; gives no coefficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.imported import late_by, unusable_because
from pmabench.analysis.shared import samples
from pmabench.analysis.shared.samples import LAG_KNOWN, LEAST, UNDECLARED, NotUsable, lags_of, noise_of, onset, step_of
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step.motion import Motion, before_sensor, behind, fit_motion, from_rest
from pmabench.store.records import Array, Flag, RunData, TrialData

BEFORE, AFTER = 0.5, 0.8
"""Range of samples before and after the command for the fit of the motion [s]."""
FEWEST = 30
"""Samples on each side that are needed."""
SEEN = 5.0
"""Smallest onset in standard deviations of the baseline; it must also exceed a twentieth of the step."""
FINE = 2
"""Samples between the level and a clear rise from which on a log shows the start of the rise."""
SHIFTS = 4
SPRUNG = 0.02
"""Relative difference of the force at rest before and after a step that a weight may show, by drift or a pulley."""


@dataclass(frozen=True, eq=False)
class Step:
    """One measured step; times in seconds from the command."""

    trial: TrialData
    t: Array
    P: Array
    x: Array
    """Pressure and contraction, each also delayed by the lag of the other's sensor, so that both lag equally."""
    size: float
    """Change of measured pressure [Pa]."""
    stroke: float
    """Change of contraction at the end of the trial [m]."""
    dead: float
    """Time from command to pressure [s]: each in the middle of the interval in which it lies, corrected for late
    stamps.
    """
    dead_half: float
    """Half width of `dead` [s], with what an undeclared filter of the gauge or a declared one that is a delay adds."""
    stamped: float
    """Command to pressure by their stamps [s]."""
    onset_half: float
    """Half of the interval in which the onset lies [s]."""
    rise: float
    """Time from the onset to 63 % of the change of pressure [s]."""
    rise_half: float
    """Half width of `rise` from the distance of samples at onset and 63 %, and from such a filter [s]."""
    driven: tuple[Array, Array, Array]
    """Time [s], pressure [Pa] and contraction [m] that the fit of the motion uses."""
    motions: tuple[Motion, ...]
    others: tuple[tuple[Array, Array], ...]
    """Pressure and contraction for that fit, with shortest and longest possible lags of the sensors."""
    noise: float
    """Noise of the displacement at rest before the step, as recorded [m]."""
    declared: bool
    """Whether the sensor of the displacement has a declared lag."""
    unresolved: dict[str, float]
    """Channel -> error of a rest because it is read in steps [SI]."""

    @property
    def near(self) -> NDArray[np.bool_]:
        """Samples that the fit of the motion uses."""
        return np.asarray((self.t >= -BEFORE) & (self.t <= AFTER))

    @property
    def best(self) -> Motion:
        """The motion with the least misfit."""
        return min(self.motions, key=lambda motion: motion.rms)

    @property
    def sprung(self) -> bool:
        """Whether a force cell reads differently after the step than before: a spring acts in addition to a weight."""
        if "force" not in self.trial.channels:
            return False
        F = self.trial.channels["force"][self.trial.usable]
        before, after = float(np.mean(F[self.t < 0])), float(np.mean(F[self.t > max(AFTER, self.t[-1] - 1.0)]))
        return abs(after - before) > SPRUNG * abs(before)

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name

    @property
    def found(self) -> bool:
        """Whether the step was found in the measured pressure, since no command was recorded."""
        return not all(command.recorded for command in self.trial.commands)


def measure(run: RunData, trial: TrialData) -> Step:
    """One step from its samples; raises `NotUsable`."""
    samples.refuse_missing(trial, "pressure", "displacement")
    command = next((c for c in trial.commands if c.kind == "set" and c.output == "pressure"), None)
    if command is None or not {"from", "pressure"} <= set(trial.point):
        if samples.nothing_moved(trial, "displacement"):
            raise NotUsable("its length is held: with a column of force the map says `kind: isometric` for such a test")
        raise NotUsable(
            "it has no step of pressure: the map cuts a file into steps with `trials: {by: step, smallest: 10 kPa}`"
        )
    samples.refuse_incomplete(trial)
    if np.any(trial.flags & np.uint16(Flag.TIME_JUMP)):
        raise NotUsable("its clock jumps")
    good = trial.usable
    if not good.any():
        raise NotUsable(f"no usable samples (flagged: {unusable_because(trial)})")
    t = trial.t[good] - command.t
    read, x = trial.channels["pressure"][good], trial.channels["displacement"][good]
    lags, late = lags_of(run, trial), late_by(run, "pressure") or (0.0, 0.0)
    slow, lag = lags["displacement"], lags["pressure"]
    over = _blurred(t, read, lag)
    P = before_sensor(t, read, lag, over) if over else read
    within = command.data.get("within", 0.0)
    before, after = (t >= -BEFORE) & (t < -within), t > 0
    if min(np.count_nonzero(before), np.count_nonzero(after)) < FEWEST or t[-1] < AFTER:
        seen = (
            f"{np.count_nonzero(before)} in {BEFORE:g} s before it, {np.count_nonzero(after)} in {t[-1]:.2g} s after it"
        )
        needed = f"{FEWEST} each and {AFTER:g} s are needed, so {FEWEST / BEFORE:g} Hz or more"
        raise NotUsable(
            f"too few usable samples around the step: {seen}; {needed} (flagged: {unusable_because(trial)})"
        )
    settled = t > max(AFTER, t[-1] - 1.0)
    size = float(P[settled].mean() - P[before].mean()) if settled.any() else 0.0
    stroke = float(x[settled].mean() - x[before].mean()) if settled.any() else 0.0
    noise = float(P[before].std())
    if abs(size) < 2 * SEEN * max(noise, 1.0):
        raise NotUsable(f"the pressure follows by {show(size, 'pressure', 3)} only, no more than its noise")
    new = samples.fresh(read)
    risen = _rise(t[new], ((P - np.median(P[before])) * np.sign(size))[new], abs(size), noise, within)
    if risen is None:
        raise NotUsable("no onset of the pressure is seen")
    begins, doubt, crossed = risen
    unsure = over / 2 + LAG_KNOWN * lag
    other = (lag if _starts_with_jump(t, P, begins, over) else 0.0) if lag else UNDECLARED
    dead = begins + within / 2 - (late[0] + late[1]) / 2
    dead_half = hypot(doubt + within / 2 + (late[1] - late[0]) / 2 + unsure, other)
    rise_half = hypot(doubt + float(np.ptp(crossed)) / 2 + unsure, other)
    driven = t[(t >= -BEFORE) & (t <= AFTER)], *_driving(t, read, x, (slow, lag))
    shifts = np.linspace(*late, SHIFTS if late[1] > late[0] else 1)
    motions = tuple(fit_motion(*driven, float(shift)) for shift in shifts)
    lagged = [(slow * (1 + by), lag) for by in (-LAG_KNOWN, LAG_KNOWN) if slow]
    lagged += [(slow, lag * (1 + by)) for by in (-LAG_KNOWN, LAG_KNOWN) if lag]
    others = tuple(_driving(t, read, x, one) for one in lagged)
    alike = behind(t, read, slow), behind(t, x, lag)
    return Step(
        trial, t, *alike, size, stroke, dead, dead_half, begins + within / 2, doubt + within / 2 + unsure,
        float(crossed.mean()) - begins, rise_half, driven, motions, others, noise_of(x[t < 0]),
        slow > 0, _unresolved(trial, good, (before, settled)),
    )  # fmt: skip


Rise = tuple[float, float, Array]
"""Onset of the pressure, its half width, and the samples around 63 % [s]."""


def _rise(t: Array, rise: Array, size: float, noise: float, within: float) -> Rise | None:
    """Rise of a pressure by `size` [Pa] above its rest; None without an onset."""
    begun = np.flatnonzero((rise > max(SEEN * noise, 0.05 * size)) & (t > -within))
    most = np.flatnonzero((rise > (1 - np.exp(-1)) * size) & (t > -within))
    if not len(begun) or not len(most) or begun[0] == 0:
        return None
    return *_onset(t, rise, int(begun[0]), within), t[max(0, most[0] - 1) : most[0] + 1]


JUMPS = 2.5
"""Ratio of the rise in the first averaging time to that in the next from which on the pressure starts with a jump."""


def _starts_with_jump(t: Array, P: Array, begins: float, over: float) -> bool:
    """Whether a pressure, corrected for a filter and averaged over the time `over` [s], starts with a jump at `begins`
    [s]: its declared lag may then be a delay.
    """
    first = np.interp(begins + over * np.arange(3), t, P)
    return bool(abs(first[1] - first[0]) > JUMPS * abs(first[2] - first[1]))


def _unresolved(trial: TrialData, good: NDArray[np.bool_], rests: Sequence[NDArray[np.bool_]]) -> dict[str, float]:
    """Channel -> error of rests among its `good` samples because it is read in steps [SI]."""
    channels = {name: values[good] for name, values in trial.channels.items()}
    return {name: max(samples.unresolved(y[rows], step_of(y)) for rows in rests) for name, y in channels.items()}


def _driving(t: Array, P: Array, x: Array, lags: tuple[float, float]) -> tuple[Array, Array]:
    """Pressure and contraction of the samples that the fit uses, each behind the lag of the other's sensor.

    `lags` [s] are those of displacement and pressure.
    """
    near = (t >= -BEFORE) & (t <= AFTER)
    pressure = from_rest(behind(t, P, lags[0])[near], float(np.median(P[near & (t < 0)])))
    return pressure, behind(t, x, lags[1])[near]


def _blurred(t: Array, P: Array, lag: float) -> float:
    """Averaging time of the pressure in the correction for its sensor's lag [s]; 0 without a lag.

    Half the lag, which limits the noise, but at least twice the time for which a polled channel keeps its value.
    """
    changes = np.diff(t[:-1][np.diff(P) != 0])
    return max(lag / 2, 2 * float(np.median(changes)) if len(changes) else 0.0) if lag else 0.0


def _onset(t: Array, rise: Array, first: int, within: float) -> tuple[float, float]:
    """Onset of a pressure rise [s] and its half width; `first` is the first sample clearly above the level.

    A threshold is crossed late, so the first part of the rise is extrapolated back to the level by a straight line
    (behind a lag, pressure rises like t). If a log has too few samples for that, the onset lies between the last sample
    at the level and `first`.
    """
    rest = rise[t < -within]
    still = np.flatnonzero(rise[:first] <= np.median(rest) + float(np.std(rest)))
    early, late = float(t[still[-1]]) if len(still) else float(t[first - 1]), float(t[first])
    period = float(np.median(np.diff(t)))
    begun = onset(t, rise, -within, LEAST["pressure"]) if late - early > FINE * period - 1e-9 else None
    if begun is None or not early - period <= begun <= late:
        return (early + late) / 2, (late - early) / 2
    return begun, period / 2 + max(0.0, min(begun - early, late - begun)) / 2
