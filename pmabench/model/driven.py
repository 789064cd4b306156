"""The driven-end plant: an actuator sets the contraction, the force follows in closed form.

Physics
-------
x(t) is the actuator's position: the commanded one, limited in speed and stroke, with a first-order follow error. The
cell at the fixed end reads F = F_0(P, x) - B(P) x' - F_c sign x' + F_h, or 0 if that is negative: a muscle cannot push.
F_0 is the pull at rest (F_ce(P) - K(P) x, or S(eps) P + F_e(eps)); F_h is a rate-independent hysteresis, if the muscle
has one. With relaxing rubber F_0 is that at P - P_c, where P_c creeps after the regulator's pressure. P is the
regulator's pressure, or with air flow the solution of the chamber equation (`pmabench.model.air`). The actuator carries
the moving mass, so inertia has no part in F. Speeds below 1 um/s count as rest.

Equal muscles in parallel pull with the sum of their forces.

If F exceeds the actuator's force it stalls: it holds its position until the next command.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pmabench.model.air import Air, Chamber
from pmabench.model.curve import Array
from pmabench.model.hysteresis import Branch, CreepAlong, Hysteresis
from pmabench.model.motion import NOTHING, Motion, Supplied
from pmabench.model.muscle import Friction
from pmabench.model.real.muscle import Creep
from pmabench.model.regulator import Regulated, Regulator, Wave, to_nanosecond

STILL = 1e-6
PARTS = ("supply", "wanted", "_drive", "_branch", "_chamber", "_creeping")


@dataclass(frozen=True)
class Actuator:
    """Limits of a displacement actuator, in the direction of contraction: stroke [m], speed [m/s], force [N].

    `lag`: time constant of its first-order follow error [s]; 0 follows exactly.
    """

    low: float = -10e-3
    high: float = 90e-3
    speed: float = 0.5
    force: float = 1500.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        if not self.low <= 0 <= self.high or not self.speed > 0 or not self.force > 0 or not self.lag >= 0:
            raise ValueError(f"an actuator needs a stroke around 0, a speed and a force above 0, not {self}")

    def approach(self, waves: tuple[Wave, ...], position: float, start: float) -> tuple[Wave, ...]:
        """The commanded positions `waves` as the actuator follows them, from `position` [m] at `start` [s].

        Steps become ramps at full speed, and ramps are limited to full speed.

        Raises
        ------
        ValueError
            For a position outside the stroke, or a sine faster than the actuator.
        """
        taken: list[Wave] = []
        for i, wave in enumerate(waves):
            begin = max(wave.start, start)
            end = waves[i + 1].start if i + 1 < len(waves) else math.inf
            last = wave.value(end) if math.isfinite(end) else wave.level
            self._check(wave, last)
            if not wave.amplitude and wave.steepest > self.speed:
                wave = Wave(wave.start, last)
            meet = self._meeting(wave, position, begin)
            slope = (wave.value(meet) - position) / (meet - begin) if meet > begin else 0.0
            if meet > begin:
                taken.append(Wave(begin, position, slope=slope))
            if meet < end:
                taken.append(wave.later(meet) if meet > wave.start else wave)
                position = last
            else:
                position += slope * (end - begin)
        return tuple(taken)

    def _check(self, wave: Wave, last: float) -> None:
        if wave.amplitude and wave.steepest > self.speed:
            raise ValueError(f"a sine of {wave.steepest:.4g} m/s is faster than the actuator ({self.speed:.4g} m/s)")
        reach = abs(wave.amplitude)
        low, high = min(wave.level - reach, last), max(wave.level + reach, last)
        if low < self.low - 1e-9 or high > self.high + 1e-9:
            raise ValueError(
                f"{low:.6g} to {high:.6g} m is outside the actuator's stroke of {self.low:.6g} to {self.high:.6g} m"
            )

    def _meeting(self, wave: Wave, position: float, begin: float) -> float:
        """Time [s] at which the actuator, at full speed from `position`, meets the wave."""
        meet = begin
        for _ in range(100):
            later = begin + abs(wave.value(meet) - position) / self.speed
            if abs(later - meet) < 1e-10:
                break
            meet = later
        return to_nanosecond(meet)


class DrivenMuscle(Protocol):
    """Interface of a muscle for the driven end; P [Pa], x [m] and v [m/s] are arrays of one shape."""

    @property
    def friction(self) -> Friction:
        """Its friction; only F_c, in motion, is used here."""

    def pull(self, P: Array, x: Array) -> Array:
        """Force at rest without friction and hysteresis [N]."""

    def damping(self, P: Array, v: Array) -> Array:
        """Damping for the direction of v [N.s/m]."""


class DrivenPlant(Supplied):
    """A muscle behind its regulator, its free end held by an actuator; `time` [s].

    Examples
    --------
    >>> import numpy as np
    >>> from pmabench.model.presets import preset
    >>> from pmabench.model.regulator import constant
    >>> setup = preset("paper0", "ideal")
    >>> plant = DrivenPlant(setup.muscle, setup.regulator, Actuator(), pressure=300e3)
    >>> plant.move(constant(0.0, 10e-3))
    >>> plant.advance(1.0, np.array([1.0])).F.round(2).tolist()
    [207.27]
    """

    parts: tuple[str, ...] = PARTS
    """Names of attributes with state that is changed in place."""

    def __init__(
        self,
        muscle: DrivenMuscle,
        regulator: Regulator,
        actuator: Actuator,
        *,
        hysteresis: Hysteresis | None = None,
        air: tuple[Air, Callable[[Array], Array]] | None = None,
        relaxes: Creep | None = None,
        parallel: int = 1,
        pressure: float = 0.0,
        position: float = 0.0,
        start: float = 0.0,
    ) -> None:
        self.muscle, self.actuator, self.time = muscle, actuator, start
        self.supply = Regulated(regulator, pressure, start)
        self.wanted = Regulated(Regulator(dead_time=0.0), position, start)
        self._drive = Regulated(Regulator(dead_time=0.0, lag=actuator.lag), position, start)
        self._branch = Branch(hysteresis, position, start) if hysteresis and hysteresis.height else None
        self._chamber = Chamber(*air, pressure, start) if air else None
        self._parallel = parallel
        self._creeping = CreepAlong(relaxes, start) if relaxes else None

    @property
    def pressure(self) -> float:
        """Present gauge pressure in the muscle [Pa]."""
        return self.supply.value(self.time) if self._chamber is None else self._chamber.pressure

    def shut(self, *, shut: bool) -> None:
        """Shut or open the valve between regulator and muscle; no effect without a chamber."""
        if self._chamber is not None:
            self._chamber.shut = shut

    def inflow(self, supply: Regulated, t: Array, P: Array) -> Array:
        """Mass flow from the regulator into the muscle [kg/s] at increasing times t [s], at gauge pressures P [Pa].

        `supply`: a copy of the regulator from before these times. 0 without a chamber, and while the valve is shut.
        """
        if self._chamber is None or self._chamber.shut:
            return np.zeros(t.shape)
        air, off = self._chamber.air, supply.values(t)[0] - P
        return np.asarray(np.where(off > 0, air.fill, air.vent) * off)

    def move(self, waves: tuple[Wave, ...]) -> None:
        """Command positions [m] by `waves`, the first of which starts now; ValueError outside the actuator's limits."""
        taken = self.actuator.approach(waves, self._drive.setpoint(self.time), self.time)
        self.wanted.command(waves)
        self._drive.command(taken)

    def halt(self) -> None:
        """Stop at the present position, and hold it."""
        self.move((Wave(self.time, self._drive.setpoint(self.time)),))

    def reading(self) -> tuple[float, float, float]:
        """Present contraction [m], gauge pressure [Pa] and force at the fixed end [N]."""
        x, _, P, F = self._evaluate(np.array([self.time]))
        return float(x[0]), float(P[0]), float(F[0])

    def advance(self, until: float, times: Sequence[float] | Array = ()) -> Motion:
        """Simulate to `until` [s]; returns the motion at increasing `times` [s] between now and `until`.

        A stall of the actuator is checked at these times and at `until`.
        """
        if len(times) == 0 and until == self.time:
            return NOTHING
        asked = np.asarray(times, dtype=np.float64)
        t = asked if len(asked) and asked[-1] == until else np.append(asked, until)
        P_set, x_set = self.supply.setpoints(t), self.wanted.setpoints(t)
        columns = [np.empty(t.shape) for _ in range(4)]
        done = 0
        while done < len(t):
            before = self._copies()
            part = self._evaluate(t[done:])
            stalls = (part[3] > self.actuator.force) & (part[1] < -STILL)
            count = int(stalls.argmax()) + 1 if stalls.any() else len(t) - done
            for column, values in zip(columns, part, strict=True):
                column[done : done + count] = values[:count]
            if stalls.any():
                self.__dict__.update(before)
                self._evaluate(t[done : done + count])
                self._hold(float(t[done + count - 1]), float(part[0][count - 1]))
            done += count
        self.wanted.piece(until)
        self.time = until
        x, v, P, F, P_set, x_set = (column[: len(asked)] for column in (*columns, P_set, x_set))
        return Motion(asked, x, v, P, F, P_set, x_set)

    def _evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Contraction [m], its rate [m/s], pressure [Pa] and force [N] at increasing times t [s]."""
        path = copy.copy(self._drive)
        x, v = self._drive.values(t)
        gone = self._creeping.along(copy.copy(self.supply), t) if self._creeping is not None else 0.0
        if self._chamber is None:
            P, _ = self.supply.values(t)
        else:
            P = self._chamber.pressures(self.supply, copy.copy(path), t)
        moves = np.abs(v) > STILL
        F = self.muscle.pull(P - gone, x) - self.muscle.damping(P, v) * v
        F -= self.muscle.friction.F_c * np.sign(v) * moves
        if self._branch is not None:
            F += self._branch.along(path, t, x)
        return x, v, P, self._parallel * np.maximum(F, 0.0)

    def _hold(self, t: float, x: float) -> None:
        """Stall: stay at x [m] from t [s] on."""
        self._drive = Regulated(Regulator(dead_time=0.0, lag=self.actuator.lag), x, t)
