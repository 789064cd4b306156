"""The free-end plant: muscle, regulator and load as an initial-value problem, solved from event to event.

Independent of device drivers, channels and noise. Driven end: `pmabench.model.driven`.

Physics
-------
The muscle pulls with F = F_ce(P) - K(P) x - B(P) x' - f, and that is what the cell at its fixed end reads. The load
pulls back with F_L, moves with mass M, and rests on a support at x = 0: M x'' = F - F_L + N, N >= 0 only at x = 0.
f is Coulomb friction inside the muscle: up to F_s at rest, F_s..F_c sliding.

* Sliding: the cell reads F = F_L + M x''.
* At rest above the support: F = F_L; the friction f = F_ce - K x - F_L carries the difference while |f| <= F_s.
* At rest on the support: the friction is as small as possible. While F_ce <= F_L the support carries F_L - F_ce and the
cell reads F_ce; above, the friction holds F_ce - F_L up to F_s, and the cell reads F_L. So the load lifts off at
F_ce = F_L + F_s. In short F = min(F_ce, F_L).
* At the muscle's own stop, mirrored: F = max(F_ce - K x, F_L).

Loads land on the support and at the stop without rebound.

Equation of motion
------------------
LSODA and the implicit steps both solve M x'' = F_ce(P) - K(P) x - B(P) x' - friction - F_L for motion in one direction;
the damping of that direction is also used beyond x' = 0, so that the caller can find the turning point. Speeds at which
the friction falls with speed are left to `glide`: the motion is unstable there, and a stiff solver may be wrong.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import odeint

from pmabench.model.curve import Array
from pmabench.model.motion import NOTHING, Course, Loaded, Motion, Record
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.regulator import Regulated, Regulator, Trace, to_nanosecond

RELATIVE = 1e-7
ABSOLUTE = 5e-9
TIME = 0.01
"""Error tolerances of LSODA per step, absolute in contraction [m] and in speed times `TIME` [s]."""
SETTLED_PRESSURE = 1e-3
"""Remaining change of pressure that counts as none [Pa]: below 1 nm of contraction."""

FARTHEST = 100.0
"""Largest number of time constants of a growing speed that are solved at once [1]."""
FELT, APART = 1e-6, 1e-6
"""Smallest relative effect of the spring within a step, and smallest relative difference of two exponents [1]."""
EXACT, SHORTEST = 1e-9, 1e-12
"""Tolerances for the time at which a speed is reached: relative in speed [1], or in time [s]."""

State = np.ndarray[tuple[int], np.dtype[np.float64]]


def equation(
    muscle: Muscle, trace: Trace, way: int, force: float, mass: float, t: float
) -> Callable[[State, float], State]:
    """Right-hand side over (x [m], x' TIME [m]) and s = t - trace.start [s], for motion towards `way` (+1, -1).

    Friction is F_c throughout: valid only for sliding faster than the knee of the friction. `force` F_L [N] and `mass`
    M [kg] of the load; pressure follows `trace` [Pa], for times from `t` [s] on, and counts as constant when it is
    settled.
    """
    f_ce, stiffness = muscle.F_ce.function(), muscle.K.function()
    damping = (muscle.B_c if way > 0 else muscle.B_r).function()
    hold = force + way * muscle.friction.F_c
    pressure, scale, result = trace.function(t - trace.start), TIME / mass, np.empty(2)

    def steady(y: State, since: float) -> State:
        x, w = y.tolist()
        v = w / TIME
        result[0] = v
        result[1] = (pull - K * x - B * v) * scale
        return result

    def moving(y: State, since: float) -> State:
        x, w = y.tolist()
        v, P = w / TIME, pressure(since)
        result[0] = v
        result[1] = (f_ce(P) - stiffness(P) * x - damping(P) * v - hold) * scale
        return result

    if trace.settled(t, SETTLED_PRESSURE):
        pull, K, B = f_ce(trace.level) - hold, stiffness(trace.level), damping(trace.level)
        return steady
    return moving


def slide(
    muscle: Muscle, trace: Trace, way: int, load: tuple[float, float], state: tuple[float, float], t: Array
) -> tuple[Array, Array]:
    """Contraction [m] and speed [m/s] at times t [s] by LSODA, from `state` (x, v) at t[0]; `load` is (F_L, M)."""
    acceleration = equation(muscle, trace, way, *load, float(t[0]))
    start = (state[0], state[1] * TIME)
    y = odeint(acceleration, start, t - trace.start, rtol=RELATIVE, atol=ABSOLUTE, mxstep=100000)
    return y[:, 0], y[:, 1] / TIME


def glide(
    friction: Friction, h: float, speed: float, drive: tuple[float, float], linear: tuple[float, float], mass: float
) -> tuple[float, float, float]:
    """Slide for at most h [s] under M u' = drive - K s - B u - friction(u), s' = u >= 0, exactly.

    `drive`: present value [N] and rate [N/s]; `linear`: B [N.s/m] and K [N/m]. In each of the two linear parts of the
    friction s is a straight line plus two exponentials: stable for any mass and damping, and exact for growing motion.

    Returns
    -------
    tuple
        Distance s [m], final speed [m/s], remaining time when the speed came to 0 [s] (else 0).
    """
    gone, left, (push, rate), (damping, stiffness) = 0.0, h, drive, linear
    knee = friction.knee
    for _ in range(6):
        if left <= 0:
            break
        fast = speed > knee or (speed == knee and push - friction.F_c >= damping * speed)
        resist, b = (friction.F_c, damping) if fast else (friction.F_s, damping - friction.slope)
        low, high = (knee, math.inf) if fast else (0.0, knee)
        near, far, level, line, A, B = _course(push - resist, rate, b, stiffness, mass, speed, left)
        exp: Callable[[Any], Any] = math.exp if isinstance(far, float) else cmath.exp
        duration = left if far.real * left < FARTHEST else FARTHEST / far.real
        near_end, far_end = A * exp(near * duration), B * exp(far * duration)
        end = (line + near * near_end + far * far_end).real
        bound = high if end > high else low if end < low else None
        if bound is not None and speed == bound:  # it cannot leave the bound in this direction
            return gone + bound * left, bound, 0.0
        if bound is not None:
            begin, off, last, beyond = 0.0, speed - bound, duration, end - bound
            for _ in range(40):  # regula falsi with the Illinois modification
                duration = last - beyond * (last - begin) / (beyond - off)
                near_end, far_end = A * exp(near * duration), B * exp(far * duration)
                error = (line + near * near_end + far * far_end).real - bound
                if (error > 0) == (beyond > 0):
                    last, beyond, off = duration, error, 0.5 * off
                else:
                    begin, off, beyond = duration, error, 0.5 * beyond
                if abs(error) < EXACT * (knee + speed) or last - begin < SHORTEST:
                    break
            end = bound
        way = (level + line * duration + near_end + far_end).real
        gone, speed, left = gone + way, end, left - duration
        push += rate * duration - stiffness * way
        if bound == 0:
            return gone, 0.0, max(left, 0.0)
    return gone, speed, 0.0


def _course(
    push: float, rate: float, b: float, stiffness: float, mass: float, speed: float, h: float
) -> tuple[complex, complex, float, float, complex, complex]:
    """S = level + line t + A exp(near t) + B exp(far t) of M s'' = push + rate t - b s' - stiffness s for `h` [s].

    From s = 0, s' = `speed`. Returns near, far [1/s], level [m], line [m/s], A, B [m]. A spring with negligible effect
    within h is replaced by one with the relative effect `FELT`, and equal exponents are separated by `APART`.
    """
    K = max(stiffness, FELT * (abs(b) + mass / h) / h)
    half = 0.5 * b / mass
    square = half * half - K / mass
    root = math.sqrt(square) if square > 0 else cmath.sqrt(square)
    if abs(root) < APART * abs(half):
        root = APART * abs(half)
    far = -half - root if half >= 0 else root - half
    near = K / mass / far
    line = rate / K
    level = (push - b * line) / K
    B = (speed - line + level * near) / (far - near)
    return near, far, level, line, -level - B, B


SETTLED_SPEED = 2e-8
SETTLED_FORCE = 5e-5
"""Below this speed [m/s] and this unbalanced force [N] a muscle counts as at rest: within 10 nm of its end."""
SHORT = 0.0041
"""Intervals up to this length [s] use fixed steps: starting LSODA is slower."""
STEP = 2e-3
"""Longest step in a loop that is closed at every sample [s]."""
LAUNCH = 1e-3
"""Longest step at speeds with falling friction [s]: exact for unstable motion, where LSODA fails."""
CREEP = 4e-3
"""The same where damping makes this motion stable, and the pressure is settled [s]."""
CALM = 100.0
"""Pressure difference from the end value that counts as settled for `CREEP` [Pa]."""
REST = 2.0
"""Longest interval of rest that is examined at once [s]."""
HORIZON = 1.0
"""Longest interval integrated at once [s]; reduced for frequent stops, since the part after a stop is discarded."""


class Plant(Loaded):
    """A muscle behind its regulator, with a load F_L = `force` [N] of moving mass `mass` [kg] on its free end.

    `time` [s], contraction `x` [m], speed `v` [m/s]; `way` is 0 at rest, else the direction of sliding, 1 or -1.

    Examples
    --------
    >>> import numpy as np
    >>> from pmabench.model.presets import preset
    >>> from pmabench.model.regulator import constant
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
        self._trace: Trace | None = None if muscle.tau_r is None else self.supply.piece(start)[0]
        self.time, self.x, self.v, self.way = start, 0.0, 0.0, 0
        self._since, self._horizon = start, HORIZON
        self.load(force, mass)

    def reading(self) -> tuple[float, float, float]:
        """Present contraction [m], gauge pressure [Pa] and force at the fixed end [N]."""
        course = self._course(self._piece()[0])
        self._start(course)
        P, muscle, way = course.value(self.time), self.muscle, self.way
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
        """Simulate to `until` [s]; returns the motion at increasing `times` [s] between now and `until`.

        Rest takes almost no computing time; sliding is integrated by LSODA, restarted at every command, stop and
        reversal; intervals up to 4 ms (a loop closed at every sample) use implicit steps.
        """
        if len(times) == 0 and until - self.time <= SHORT:
            self.reach(until)
            return NOTHING
        t = np.asarray(times, dtype=np.float64)
        record = Record(t, self.supply.setpoints(t))
        while self.time < until:
            trace, end = self._piece()
            end = min(end, until)
            if self.way == 0:
                self._rest(trace, min(end, to_nanosecond(self.time + REST)), record)
            elif end - self.time <= SHORT:
                self._stepwise(trace, end, record, LAUNCH, math.inf)
            elif self.way * self.v < self.muscle.friction.knee:
                soon = min(end, to_nanosecond(self.time + HORIZON))
                self._stepwise(trace, soon, record, self._fine_step(trace), 1.05 * self.muscle.friction.knee)
            else:
                self._slide(trace, min(end, to_nanosecond(self.time + self._horizon)), record)
        if record.done < len(t):
            course = self._course(self._piece()[0])
            self._start(course)
            self._fill(record, np.full(len(t) - record.done, self.x), self.v, course, self.way)
        return record.motion()

    def reach(self, until: float, longest: float = STEP) -> None:
        """Simulate to `until` [s] in implicit steps of at most `longest` [s].

        For loops that are closed at every sample. Linearly implicit: pressure and coefficients at the middle of the
        step, friction and damping in closed form (`glide`), the spring by the trapezoidal rule; stable for any mass.
        """
        while self.time < until:
            trace, end = self._piece()
            self._steps(trace, min(end, until), longest)

    def _piece(self) -> tuple[Trace, float]:
        """Current course of the pressure and its end [s]; where it starts to fall, the muscle is set to relaxation."""
        trace, end = self.supply.piece(self.time)
        if self._trace is not None and trace != self._trace:
            before, self._trace = self._trace.value(trace.start), trace
            if trace.slope < 0 or (trace.slope == 0 and trace.level < before):
                self.muscle = self.muscle.released(before)
                self._damping = {**self._damping, -1: self.muscle.B_r.function()}
        return trace, end

    def _course(self, trace: Trace) -> Course:
        """Pressure in the muscle up to now; here the regulator's `trace`."""
        return trace

    def _fill(self, record: Record, x: Array, v: Array | float, course: Course, way: int) -> None:
        """Record the next len(x) samples: contraction, speed, and the resulting pressure and force."""
        P, muscle = course.values(record.due(len(x))), self.muscle
        if way == 0 and 0 < self.x < muscle.stop:
            record.fill(x, v, P, self.force)
            return
        F = muscle.pull(P, x)
        if way:
            speed = np.abs(v)
            damping = (muscle.B_c if way > 0 else muscle.B_r).values(P)
            F -= way * (damping * speed + muscle.friction.values(speed))
        else:
            F = np.minimum(F, self.force) if self.x <= 0 else np.maximum(F, self.force)
        record.fill(x, v, P, F)

    # -- at rest -------------------------------------------------------------------------------------------------

    def _drive(self, P: float) -> float:
        """Unbalanced force without friction [N]."""
        return self._f_ce(P) - self._stiffness(P) * self.x - self.force

    def _breaks_away(self, drive: float) -> int:
        """Direction in which a muscle at rest starts to slide; 0 if it stays at rest."""
        hold = self.muscle.friction.F_s + SETTLED_FORCE
        if drive > hold and self.x < self.muscle.stop:
            return 1
        return -1 if drive < -hold and self.x > 0 else 0

    def _start(self, course: Course) -> None:
        """Begin to slide if the present pressure overcomes the friction of a muscle at rest."""
        if self.way == 0:
            self.way = self._breaks_away(self._drive(course.value(self.time)))

    def _rest(self, trace: Trace, end: float, record: Record) -> None:
        """Stay at rest until break-away or `end` [s], whichever is first."""
        self._start(trace)
        if self.way:
            return
        if trace.settled(self.time, SETTLED_PRESSURE):
            self._fill(record, np.full(record.count(end), self.x), 0.0, trace, 0)
            self.time = self._since = end
            return
        t, _ = record.grid(self.time, end)
        P = trace.values(t)
        drive = self.muscle.pull(P, np.full(P.shape, self.x)) - self.force
        hold = self.muscle.friction.F_s + SETTLED_FORCE
        free = ((drive > hold) & (self.x < self.muscle.stop)) | ((drive < -hold) & (self.x > 0))
        free[0] = False
        first = int(free.argmax())
        if first:
            low, high = float(t[first - 1]), float(t[first])
            for _ in range(40):
                middle = 0.5 * (low + high)
                if self._breaks_away(self._drive(trace.value(middle))):
                    high = middle
                else:
                    low = middle
            end = min(math.ceil(high * 1e9) / 1e9, end)
        self._fill(record, np.full(record.count(end), self.x), 0.0, trace, 0)
        self.time = self._since = end
        if first:
            self.way = self._breaks_away(self._drive(trace.value(high)))

    # -- sliding -------------------------------------------------------------------------------------------------

    def _slide(self, trace: Trace, end: float, record: Record) -> None:
        """Slide until it reverses, lands, settles, slows down to falling friction, or until `end` [s]."""
        t, rows = record.grid(self.time, end)
        x, v, course = self._integrate(trace, (self.x, self.v), t)
        first = self._first_event(course, t, x, v)
        if first is None:
            self._fill(record, x[rows], v[rows], course, self.way)
            self.x, self.v, self.time = float(x[-1]), float(v[-1]), end
            self._horizon = min(2 * self._horizon, HORIZON)
            return
        before = first - 1
        fine = np.linspace(t[before], t[first], 65)
        fine_x, fine_v, fine_course = self._integrate(trace, (float(x[before]), float(v[before])), fine)
        found = self._first_event(fine_course, fine, fine_x, fine_v) or len(fine) - 1
        moment, place, lands = self._refine(fine, fine_x, fine_v, found)
        rows = rows[: record.count(moment)]
        self._fill(record, x[rows], v[rows], course, self.way)
        self.time, self.x, self.v = moment, place, 0.0
        self._horizon = min(max(1.2 * (moment - self._since), SHORT), HORIZON)
        self._since = moment
        if lands or self.muscle.friction.knee == 0:
            self._stop(fine_course, lands)
        else:
            self.v = self.way * self.muscle.friction.knee * (1 - 1e-9)

    def _integrate(self, trace: Trace, state: tuple[float, float], t: Array) -> tuple[Array, Array, Course]:
        """Contraction [m], speed [m/s] and course of pressure at times t [s], from `state` (x, v) at t[0]."""
        x, v = slide(self.muscle, trace, self.way, (self.force, self.mass), state, t)
        return x, v, trace

    def _first_event(self, course: Course, t: Array, x: Array, v: Array) -> int | None:
        """Index of the first time after t[0] at which the muscle has reversed, become slow, landed or settled."""
        event = self.way * v < self.muscle.friction.knee
        event |= x > self.muscle.stop if self.way > 0 else x < 0
        slow = np.flatnonzero(np.abs(v) < SETTLED_SPEED)
        if slow.size:
            drive = self.muscle.pull(course.values(t[slow]), x[slow]) - self.force
            event[slow] |= np.abs(drive) < SETTLED_FORCE
        event[0] = False
        return int(event.argmax()) if event.any() else None

    def _refine(self, t: Array, x: Array, v: Array, i: int) -> tuple[float, float, bool]:
        """Time [s] and position [m] of the event between t[i - 1] and t[i], interpolated, and whether it is landing."""
        stop = self.muscle.stop
        bound = stop if self.way > 0 and x[i] > stop else 0.0 if self.way < 0 and x[i] < 0 else None
        if bound is not None:
            share = float((bound - x[i - 1]) / (x[i] - x[i - 1]))
        else:
            before, after = self.way * float(v[i - 1]) - self.muscle.friction.knee, self.way * float(v[i] - v[i - 1])
            share = min(max(-before / after, 0.0), 1.0) if after < 0 else 1.0
        moment = float(t[i - 1] + share * (t[i] - t[i - 1]))
        place = bound if bound is not None else float(x[i - 1] + share * (x[i] - x[i - 1]))
        moment = to_nanosecond(moment if moment - self.time > 1e-9 else float(t[i]))
        return moment, min(max(place, 0.0), stop), bound is not None

    def _stop(self, course: Course, lands: bool) -> None:
        """After the speed came to 0: rest, or slide back."""
        drive = self._drive(course.value(self.time))
        self.way = 0 if lands and drive * self.way > 0 else self._breaks_away(drive)

    # -- stepping ------------------------------------------------------------------------------------------------

    def _fine_step(self, trace: Trace) -> float:
        """Longest step at speeds with falling friction [s]."""
        P = self._course(trace).value(self.time)
        calm = abs(P - trace.level) < CALM and trace.settled(self.time, CALM)
        return CREEP if calm and self._damping[self.way](P) > 2 * self.muscle.friction.slope else LAUNCH

    def _stepwise(self, trace: Trace, end: float, record: Record, longest: float, speed: float) -> None:
        """Slide in steps of at most `longest` [s] until `end`, reversal, rest, or the speed `speed` [m/s]."""
        way, samples, x, v = self.way, record.due(record.count(end)).tolist(), [], []
        due = 0
        while self.time < end and self.way == way and way * self.v < speed:
            sample = samples[due] if due < len(samples) else math.inf
            if sample <= self.time:
                x.append(self.x)
                v.append(self.v)
                due += 1
                continue
            target = min(sample, end)
            parts = math.ceil((target - self.time) / longest * (1 - 1e-9))
            self._step(trace, target if parts <= 1 else to_nanosecond(self.time + (target - self.time) / parts))
        self._fill(record, np.array(x), np.array(v), self._course(trace), way)

    def _steps(self, trace: Trace, until: float, longest: float) -> None:
        count = int((until - self.time) / longest * (1 - 1e-9)) + 1 if until > self.time else 0
        begin = self.time
        for i in range(1, count + 1):
            self._step(trace, until if i == count else begin + (until - begin) * i / count)

    def _ends(self, trace: Trace, until: float) -> tuple[float, float, float, float]:
        """Pressures [Pa] now, at `until` at rest, at `until` in motion; and the loss of force per distance [N/m]."""
        end = trace.value(until)
        return trace.value(self.time), end, end, 0.0

    def _step(self, trace: Trace, until: float) -> None:
        """One step to `until` [s], sliding or at rest, with a linear unbalanced force, and K and B at the middle."""
        muscle, h, begin = self.muscle, until - self.time, self.x
        P, P_end, P_moved, air = self._ends(trace, until)
        F, K = self._f_ce(P), self._stiffness(P)
        F_end, K_end = (F, K) if P_end == P else (self._f_ce(P_end), self._stiffness(P_end))
        left = h
        for _ in range(3):
            share = left / h
            drive = F_end - (F_end - F) * share - (K_end - (K_end - K) * share) * self.x - self.force
            end = F_end - K_end * self.x - self.force
            if air:
                drive -= air * (self.x - begin)
                end -= air * (self.x - begin)
            if self.way == 0:
                self.way = self._breaks_away(drive)
            if self.way == 0:
                self.way = self._breaks_away(end)
                if self.way == 0:
                    break
                hold = self.way * (muscle.friction.F_s + SETTLED_FORCE)
                left *= (end - hold) / (end - drive)
                drive = hold
                if left <= 0:
                    break
            B = self._damping[self.way]
            damping = B(P) if P_moved == P else 0.5 * (B(P) + B(P_moved))
            way, course = self.way, (self.way * drive, self.way * (end - drive) / left)
            linear = damping, 0.5 * (K + K_end) + air
            gone, speed, left = glide(muscle.friction, left, way * self.v, course, linear, self.mass)
            self.x += way * gone
            self.v = way * speed
            if not 0 <= self.x <= muscle.stop:
                self.x = min(max(self.x, 0.0), muscle.stop)
                self.v, left = 0.0, 0.0
                self.way = 0
            elif speed == 0 or (speed < SETTLED_SPEED and abs(end - way * (K_end + air) * gone) < SETTLED_FORCE):
                self.v, self.way = 0.0, 0
            if left == 0:
                break
        self.time = until
