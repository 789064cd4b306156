"""The free-end plant: muscle, regulator and load as an initial-value problem, advanced from event to event.

Knows no driver, no channel, no noise. Driven end: `pmabench.model.driven`.

Physics
-------
The muscle pulls with F = F_ce(P) - K(P) x - B(P) x' - f, and that is what the cell at its fixed end reads. The load
pulls back with F_L, moves with mass M, and rests on a support at x = 0: M x'' = F - F_L + N, N >= 0 only at x = 0.
f is Coulomb friction inside the muscle: up to F_s at rest, F_s..F_c sliding.

* Sliding: the cell reads F = F_L + M x''.
* At rest above the support: F = F_L; the friction takes the rest, f = F_ce - K x - F_L, until |f| would pass F_s.
* At rest on the support: the friction is as small as it can be. While F_ce <= F_L the support carries F_L - F_ce and
  the cell reads F_ce; above, the friction holds F_ce - F_L until it passes F_s, and the cell reads F_L. The load
  thus lifts at F_ce = F_L + F_s. In short F = min(F_ce, F_L).
* At the muscle's own stop, mirrored: F = max(F_ce - K x, F_L).

Loads land on the support and at the stop without rebound.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.model.curve import Array
from pmabench.model.muscle import Muscle
from pmabench.model.regulator import Regulated, Regulator, Trace
from pmabench.model.signal import Wave
from pmabench.model.slip import glide, slide

SETTLED_SPEED = 2e-8
SETTLED_FORCE = 5e-5
"""Slower than this [m/s] with less than this out of balance [N], a muscle counts as at rest: 10 nm from its end."""
SHORT = 0.0041
"""Stretches up to this length [s] are stepped: starting LSODA costs more than they do."""
STEP = 5e-4
"""Longest step of those [s]."""
GAP = 0.004
"""Longest time that is not looked at for a turn of motion [s]."""


@dataclass(frozen=True)
class Motion:
    """What the plant did at times `t` [s]: all arrays of the same length, SI."""

    t: Array
    x: Array
    """Contraction [m]."""
    v: Array
    """Its rate [m/s]."""
    P: Array
    """Gauge pressure in the muscle [Pa]."""
    F: Array
    """Force at the fixed end [N]."""
    P_set: Array
    """Pressure commanded, before the dead time [Pa]."""
    x_set: Array
    """Position commanded to the free end [m]; 0 where it is free."""


class Plant:
    """A muscle behind its regulator, with a load F_L = `force` [N] of moving mass `mass` [kg] on its free end.

    `time` [s], contraction `x` [m], speed `v` [m/s]; `way` is 0 at rest, else the direction of sliding.

    Examples
    --------
    >>> import numpy as np
    >>> from pmabench.model.presets import preset
    >>> from pmabench.model.signal import constant
    >>> setup = preset("paper0", "ideal")
    >>> plant = Plant(setup.muscle, setup.regulator, force=58.86, mass=0.5)
    >>> plant.command(constant(0.0, 300e3))
    >>> motion = plant.advance(10.0, np.array([0.04, 10.0]))
    >>> (motion.x * 1e3).round(2).tolist()
    [0.0, 31.91]
    """

    def __init__(
        self,
        muscle: Muscle,
        regulator: Regulator,
        *,
        force: float = 0.0,
        mass: float = 0.5,
        pressure: float = 0.0,
        start: float = 0.0,
    ) -> None:
        self.muscle = muscle
        self._f_ce, self._stiffness = muscle.F_ce.function(), muscle.K.function()
        self._damping = {1: muscle.B_c.function(), -1: muscle.B_r.function()}
        self.supply = Regulated(regulator, pressure, start)
        self.time, self.x, self.v, self.way = start, 0.0, 0.0, 0
        self.load(force, mass)

    def load(self, force: float, mass: float) -> None:
        """From now on the free end carries F_L = `force` [N >= 0] and moves with `mass` [kg > 0]."""
        if not force >= 0 or not mass > 0:
            raise ValueError(f"a load needs a force of at least 0 and a mass above 0, not {force} N and {mass} kg")
        self.force, self.mass = force, mass

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Command pressure [Pa] along `waves`, the first of which starts now or later."""
        self.supply.command(waves)

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to come back to this moment."""
        return {**self.__dict__, "supply": copy.copy(self.supply)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to the moment of a snapshot; it can be used again."""
        self.__dict__.update(snapshot)
        self.supply = copy.copy(self.supply)

    def reading(self) -> tuple[float, float, float]:
        """Contraction [m], gauge pressure [Pa] and force at the fixed end [N] at this moment."""
        trace = self.supply.piece(self.time)[0]
        self._start(trace)
        P, muscle, way = trace.value(self.time), self.muscle, self.way
        pull = self._f_ce(P) - self._stiffness(P) * self.x
        if way:
            u = way * self.v
            damping = self._damping[way](P)
            friction = max(muscle.friction.F_c, muscle.friction.F_s - muscle.friction.slope * u)
            return self.x, P, pull - damping * self.v - way * friction
        if self.x <= 0:
            return self.x, P, min(pull, self.force)
        return self.x, P, max(pull, self.force) if self.x >= muscle.stop else self.force

    def advance(self, until: float, times: Sequence[float] | Array = ()) -> Motion:
        """Go on to `until` [s] and tell what happened at `times` [s], rising, between now and `until`.

        Stretches without motion cost next to nothing; sliding is integrated by LSODA, restarted at every command,
        stop and turn; stretches up to 4 ms (a loop closed every sample) are taken by implicit steps.
        """
        if len(times) == 0 and until - self.time <= SHORT:
            self.reach(until)
            return _NOTHING
        t = np.asarray(times, dtype=np.float64)
        record = _Record(t, self.supply.setpoints(t))
        while self.time < until:
            trace, end = self.supply.piece(self.time)
            end = min(end, until)
            if self.way == 0:
                self._rest(trace, end, record)
            elif end - self.time <= SHORT:
                self._short(trace, end, record)
            else:
                self._slide(trace, min(end, self.time + 1.0), record)
        if record.done < len(t):
            trace = self.supply.piece(self.time)[0]
            self._start(trace)
            record.fill(np.full(len(t) - record.done, self.x), self.v, trace, self)
        return record.motion()

    def step(self, dt: float) -> None:
        """One implicit step of dt [s] with the command as it is: for loops that are closed every sample.

        Linearly implicit: pressure and coefficients at the middle of the step, friction and damping in closed form
        (`slip.glide`), the spring by the trapezoidal rule; stable for any mass.
        """
        self.reach(self.time + dt, dt)

    def reach(self, until: float, longest: float = STEP) -> None:
        """Implicit steps of at most `longest` [s] up to `until` [s]."""
        while self.time < until:
            trace, end = self.supply.piece(self.time)
            self._steps(trace, min(end, until), longest)

    # -- at rest -------------------------------------------------------------------------------------------------

    def _drive(self, P: float) -> float:
        """Force out of balance without friction [N]."""
        return self._f_ce(P) - self._stiffness(P) * self.x - self.force

    def _breaks_away(self, drive: float) -> int:
        """The direction in which a muscle at rest starts to slide; 0 if it stays."""
        hold = self.muscle.friction.F_s + SETTLED_FORCE
        if drive > hold and self.x < self.muscle.stop:
            return 1
        if drive < -hold and self.x > 0:
            return -1
        return 0

    def _start(self, trace: Trace) -> None:
        """Begin to slide where the pressure at this moment makes a muscle at rest do so."""
        if self.way == 0:
            self.way = self._breaks_away(self._drive(trace.value(self.time)))

    def _rest(self, trace: Trace, end: float, record: _Record) -> None:
        """Stay at rest until break-away or `end`, whichever is first."""
        self._start(trace)
        if self.way:
            return
        grid = record.grid(self.time, end)
        P = trace.values(grid.t)
        drive = self.muscle.pull(P, np.full(P.shape, self.x)) - self.force
        hold = self.muscle.friction.F_s + SETTLED_FORCE
        free = np.zeros(P.shape, dtype=np.bool_)
        if self.x < self.muscle.stop:
            free |= drive > hold
        if self.x > 0:
            free |= drive < -hold
        first = int(free.argmax()) if free.any() else 0
        if first:
            low, high = float(grid.t[first - 1]), float(grid.t[first])
            for _ in range(40):
                middle = 0.5 * (low + high)
                if self._breaks_away(self._drive(trace.value(middle))):
                    high = middle
                else:
                    low = middle
            end = high
        record.fill(np.full(grid.count(end), self.x), 0.0, trace, self)
        self.time = end
        if first:
            self.way = self._breaks_away(self._drive(trace.value(end)))

    # -- sliding -------------------------------------------------------------------------------------------------

    def _slide(self, trace: Trace, end: float, record: _Record) -> None:
        """Slide until it turns, lands, settles, or `end`."""
        grid = record.grid(self.time, end)
        load = self.force, self.mass
        x, v = slide(self.muscle, trace, self.way, load, (self.x, self.v), grid.t)
        first = self._first_event(trace, grid.t, x, v)
        if first is None:
            self._record_slide(trace, grid, x, v, end, record)
            self.x, self.v, self.time = float(x[-1]), float(v[-1]), end
            return
        before = first - 1
        fine = np.linspace(grid.t[before], grid.t[first], 65)
        fine_x, fine_v = slide(self.muscle, trace, self.way, load, (float(x[before]), float(v[before])), fine)
        found = self._first_event(trace, fine, fine_x, fine_v) or len(fine) - 1
        moment, place, lands = self._refine(fine, fine_x, fine_v, found)
        self._record_slide(trace, grid, x, v, moment, record)
        self.time, self.x, self.v = moment, place, 0.0
        self._stand(trace, lands)

    def _first_event(self, trace: Trace, t: Array, x: Array, v: Array) -> int | None:
        """Index of the first time after t[0] at which the muscle has turned, landed or settled."""
        event = (self.way * v < 0) | (x < 0) | (x > self.muscle.stop)
        slow = np.flatnonzero(np.abs(v) < SETTLED_SPEED)
        if slow.size:
            drive = self.muscle.pull(trace.values(t[slow]), x[slow]) - self.force
            event[slow] |= np.abs(drive) < SETTLED_FORCE
        event[0] = False
        return int(event.argmax()) if event.any() else None

    def _refine(self, t: Array, x: Array, v: Array, i: int) -> tuple[float, float, bool]:
        """Moment, place, and whether it lands, of the event between t[i - 1] and t[i], by straight lines."""
        stop = self.muscle.stop
        bound = 0.0 if x[i] < 0 else stop if x[i] > stop else None
        if bound is not None:
            share = float((bound - x[i - 1]) / (x[i] - x[i - 1]))
        elif self.way * v[i] < 0 < self.way * v[i - 1]:
            share = float(v[i - 1] / (v[i - 1] - v[i]))
        else:
            share = 1.0
        moment = float(t[i - 1] + share * (t[i] - t[i - 1]))
        place = bound if bound is not None else float(x[i - 1] + share * (x[i] - x[i - 1]))
        if moment - self.time < 1e-9:
            moment = float(t[i])
        return moment, min(max(place, 0.0), stop), bound is not None

    def _stand(self, trace: Trace, lands: bool) -> None:
        """With the speed just come to 0: stay, or slide back."""
        drive = self._drive(trace.value(self.time))
        if lands and drive * self.way > 0:
            self.way = 0
        else:
            self.way = self._breaks_away(drive)

    def _record_slide(self, trace: Trace, grid: _Grid, x: Array, v: Array, end: float, record: _Record) -> None:
        rows = grid.rows[: grid.count(end)]
        record.fill(x[rows], v[rows], trace, self)

    # -- stepping ------------------------------------------------------------------------------------------------

    def _short(self, trace: Trace, end: float, record: _Record) -> None:
        """Steps from sample to sample up to `end`."""
        for target in record.between(self.time, end):
            self._steps(trace, target, STEP)
            record.fill(np.array([self.x]), self.v, trace, self)
        self._steps(trace, end, STEP)

    def _steps(self, trace: Trace, until: float, longest: float) -> None:
        count = int((until - self.time) / longest * (1 - 1e-9)) + 1 if until > self.time else 0
        begin = self.time
        for i in range(1, count + 1):
            self._step(trace, until if i == count else begin + (until - begin) * i / count)

    def _step(self, trace: Trace, until: float) -> None:
        muscle, h = self.muscle, until - self.time
        middle = trace.value(0.5 * (self.time + until))
        f_ce, stiffness = self._f_ce(middle), self._stiffness(middle)
        for _ in range(3):
            drive = f_ce - stiffness * self.x - self.force
            if self.way == 0:
                self.way = self._breaks_away(drive)
                if self.way == 0:
                    break
            damping = self._damping[self.way](middle) + 0.5 * h * stiffness
            gone, speed, left = glide(muscle.friction, h, self.way * self.v, self.way * drive, damping, self.mass)
            self.x += self.way * gone
            self.v = self.way * speed
            if not 0 <= self.x <= muscle.stop:
                self.x = min(max(self.x, 0.0), muscle.stop)
                self.v, left = 0.0, 0.0
                self.way = 0
            elif speed == 0 or (speed < SETTLED_SPEED and abs(drive) < SETTLED_FORCE):
                self.v, self.way = 0.0, 0
            if left == 0:
                break
            h = left
        self.time = until


class _Grid:
    """Times to look at, from now to the end of a stretch, with the rows that are samples."""

    def __init__(self, t: Array, rows: NDArray[np.intp], samples: Array) -> None:
        self.t, self.rows, self._samples = t, rows, samples

    def count(self, end: float) -> int:
        """How many of the samples lie before `end`."""
        return int(np.searchsorted(self._samples, end))


class _Record:
    """Samples asked for, and how many are done."""

    def __init__(self, t: Array, P_set: Array) -> None:
        self.t, self.P_set = t, P_set
        self.x, self.v, self.P, self.F = (np.empty(t.shape) for _ in range(4))
        self.done = 0

    def between(self, now: float, end: float) -> list[float]:
        """Samples that are due before `end`."""
        last = int(np.searchsorted(self.t, end))
        return [float(moment) for moment in self.t[self.done : last]]

    def grid(self, now: float, end: float) -> _Grid:
        """The samples before `end` with `now` first and `end` last, filled up where they are far apart."""
        samples = self.t[self.done : int(np.searchsorted(self.t, end))]
        times = np.concatenate(([now], samples[samples > now], [end]))
        if np.diff(times).max() > GAP:
            even = np.linspace(now, end, int((end - now) / GAP) + 2)
            times = np.union1d(times, even)
        return _Grid(times, np.searchsorted(times, samples), samples)

    def fill(self, x: Array, v: Array | float, trace: Trace, plant: Plant) -> None:
        """The next len(x) samples: contraction, speed, and what follows from them."""
        rows = slice(self.done, self.done + len(x))
        P = trace.values(self.t[rows])
        self.x[rows], self.v[rows], self.P[rows] = x, v, P
        self.F[rows] = _cell(plant, P, x, self.v[rows])
        self.done += len(x)

    def motion(self) -> Motion:
        """All samples."""
        return Motion(self.t, self.x, self.v, self.P, self.F, self.P_set, np.zeros(self.t.shape))


def _cell(plant: Plant, P: Array, x: Array, v: Array) -> Array:
    """Force at the fixed end [N]; see the physics above."""
    muscle, force, way = plant.muscle, plant.force, plant.way
    pull = muscle.pull(P, x)
    if way:
        return np.asarray(pull - muscle.damping(P, way * np.abs(v)) * v - way * muscle.friction.values(np.abs(v)))
    if plant.x <= 0:
        return np.minimum(pull, force)
    if plant.x >= muscle.stop:
        return np.maximum(pull, force)
    return np.full(P.shape, force)


_NOTHING = Motion(*(np.empty(0) for _ in range(7)))
