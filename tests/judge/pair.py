"""Torques of two muscles on a pulley at locked angles, for pairs of pressures, sound or with one fault of known size.

A muscle pulls F = S P + F_e by a form that Sarosi fitted to a real one, S = a1 e^(a3 k) + a4 k + a5 and
F_e = a2 e^(a3 k) + a6 (k in % of contraction, P in bar, rounded). Its hysteresis is that of Maxwell's slip blocks: each
a spring that slides at a load of its own. The regulators give way while the joint turns and come back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

RADIUS, LENGTH, PRELOAD = 30e-3, 0.25, 11.0
"""[m], [m], contraction of both at angle 0 [%]."""
A1, A2, A3, A4, A5, A6 = -4.0, 260.0, -0.2, -7.6, 290.0, -100.0
"""[N/bar], [N], 1/%, N/bar/%, N/bar, N."""
BLOCKS = ((0.15, 0.30), (0.35, 0.35), (0.8, 0.35))
"""Contraction at which a block slides [%], and its share of the whole."""
RUBS, RUBS_BY_PRESSURE = 9.0, 5.0
"""Load of all blocks of a muscle [N], and its growth with the pressure [N/bar]."""
DAMPING = 0.04
"""[N.m.s/rad]"""
LEVELS = (200e3, 300e3, 400e3)
ANGLES = tuple(np.radians((-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0)).tolist())
OVERRUN, SPEED = np.radians(10.0), np.radians(20.0)
CYCLES, REPEATS, REST, SETTLE, PAUSE = 2, 2, 1.5, 3.0, 12.0
RATE = 50.0
GIVES, COMES = 4e3, 0.12
"""A regulator is off by so much in a motion at 1 rad/s [Pa s/rad], and comes back with this time constant [s]."""
NOISE = {"torque": 0.02, "angle": 3.5e-4, "pressure_1": 300.0, "pressure_2": 300.0}
SCATTER = 8e-3
"""Between trials, standard deviation of the torque of each muscle [N.m]."""
FULL = {
    "clean": 0.0, "cell-drift": 0.8, "cell-jump": 0.4, "torque-lag": 0.5, "backlash": np.radians(1.0),
    "angle-offset": np.radians(2.0), "angle-scale": 0.05, "gives-way": 4.0, "gives-way-unseen": 4.0, "slip": 1.0,
    "creep": 0.08, "unequal": 0.15, "eccentric": 0.10, "friction": 0.4, "not-linear": 0.10, "slack": 120.0,
    "pressure-scale": 0.04, "shaking": 0.3,
}  # fmt: skip
"""Cause -> its full size: N.m over all trials; N.m; s; rad; rad; share; times; times; % of contraction; share of the
force in a decade of time; share; share; N.m; share; N; share; N.m at 0.7 Hz."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")


@dataclass(frozen=True)
class Joint:
    """What the faults change in the joint itself."""

    weaker: float = 0.0
    """Muscle 2 pulls so much less [1]."""
    eccentric: float = 0.0
    """R = R0 (1 + eccentric sin(angle))."""
    bent: float = 0.0
    """Share by which the pull per pressure falls over 5 bar."""
    lower: float = 0.0
    """Both muscles pull so much less [N]: at little pressure one goes slack."""

    @classmethod
    def of(cls, cause: str, amount: float) -> Joint:
        name = {"unequal": "weaker", "eccentric": "eccentric", "not-linear": "bent", "slack": "lower"}.get(cause)
        return cls(**{name: amount}) if name else cls()

    def radius(self, angle: Array) -> Array:
        return np.asarray(RADIUS * (1 + self.eccentric * np.sin(angle)))

    def contraction(self, angle: Array, sign: int) -> Array:
        """[%]; of an eccentric pulley the rope is the integral of the radius."""
        rope = RADIUS * (angle + self.eccentric * (1 - np.cos(angle)))
        return np.asarray(PRELOAD + sign * 100 * rope / LENGTH)

    def pull(self, k: Array, P: Array | float, second: bool) -> Array:
        """Force without hysteresis and before a clamp [N]."""
        p = np.asarray(P) / 1e5
        by_pressure = (A1 * np.exp(A3 * k) + A4 * k + A5) * p * (1 - self.bent * p / 5)
        force = by_pressure + A2 * np.exp(A3 * k) + A6 - self.lower
        return np.asarray(force * (1 - self.weaker if second else 1.0))

    def torque(self, angle: Array, P: tuple[float, float], rubs: float = 0.0) -> Array:
        """[N.m], of all blocks slid against the motion with `rubs` +-1, or in the middle with 0."""
        first, second = (
            np.maximum(0.0, self.pull(self.contraction(angle, sign), P[n], n == 1) - sign * rubs * load(P[n]))
            for n, sign in enumerate((1, -1))
        )
        return np.asarray(self.radius(angle) * (first - second))


def load(P: float) -> float:
    """Of all slipping blocks of a muscle [N]."""
    return RUBS + RUBS_BY_PRESSURE * P / 1e5


def place(at: Mapping[str, float]) -> float:
    """One number for a pair of pressures and an angle, or for either; 0 where one is none of the plan."""
    pair = [1 + LEVELS.index(at[name]) if name in at else 0 for name in ("pressure_1", "pressure_2")]
    angle = 1 + int(np.argmin(np.abs(np.array(ANGLES) - at["angle"]))) if "angle" in at else 0
    return float(100 * pair[0] + 10 * pair[1] + angle)


def truth(cause: str, size: float) -> Truth:
    """Torques and slopes at the angles that were asked for; where a pull is bent over the pressure, all its tangents."""
    amount = size * FULL[cause]
    joint, right = Joint.of(cause, amount), Truth()
    angles, step = np.array(ANGLES), 1e-5
    rubbing = 2 * amount if cause == "friction" else 0.0
    for P in product(LEVELS, LEVELS):
        at = dict(zip(("pressure_1", "pressure_2"), P, strict=True))
        ways = [joint.torque(angles, P, rubs) for rubs in (-1.0, 1.0)]
        taut = [ways[0] - ways[1] - joint.radius(angles) * 2 * (load(P[0]) + load(P[1]))]
        stiff = -(joint.torque(angles + step, P) - joint.torque(angles - step, P)) / (2 * step)
        for n, angle in enumerate(ANGLES):
            whole = abs(float(taut[0][n])) < 1e-9
            ends = sorted((float(joint.torque(angles, P)[n]), float(0.5 * (ways[0] + ways[1])[n])))
            right["tau", "", place(at | {"angle": angle})] = (ends[0], ends[1])
            if whole:
                right["K_th", "", place(at | {"angle": angle})] = (float(stiff[n]),) * 2
        gap = float((ways[0] - ways[1])[len(angles) // 2]) + rubbing
        if cause != "creep":  # what goes on after a motion is a gap, too, and depends on the rest
            right["H_tau", "", place(at)] = (gap, gap)
    for angle in ANGLES:
        first, second = (joint.contraction(np.array(angle), sign) for sign in (1, -1))
        for symbol, k, other in (("s_1", first, False), ("s_2", second, True)):
            ends = [
                float(joint.radius(np.array(angle)) * (joint.pull(k, P + 1.0, other) - joint.pull(k, P - 1.0, other)) / 2)
                for P in (LEVELS[0], LEVELS[-1])
            ]  # fmt: skip
            right[symbol, "", place({"angle": angle})] = (min(ends), max(ends))
        if cause not in ("not-linear", "slack"):
            plain = float(
                joint.radius(np.array(angle)) * (joint.pull(first, 0.0, False) - joint.pull(second, 0.0, True))
            )
            right["tau_0", "", place({"angle": angle})] = (plain, plain)
    return right


def _slid(k: Array) -> Array:
    """State of all blocks of a muscle from -1 to 1 along its contraction [%]; against the motion it pulls less."""
    way = np.diff(k, prepend=k[0])
    turns = np.flatnonzero(np.diff(np.sign(way[way != 0]))) + 1
    corners = np.flatnonzero(way != 0)[turns] if len(turns) else np.array([], dtype=int)
    state = np.zeros_like(k)
    for width, share in BLOCKS:
        last = 0.0
        for begin, end in zip([0, *corners], [*corners, len(k)], strict=True):
            from_ = k[begin - 1] if begin else k[0]
            part = np.clip(last + (k[begin:end] - from_) / width, -1.0, 1.0)
            state[begin:end] += share * part
            last = float(part[-1])
    return state


def _course() -> tuple[Array, Array, list[tuple[float, float, float, str]]]:
    """Time [s], angle that is commanded [rad], ramps as (begin, value, before, phase) of one trial."""
    lowest, highest = ANGLES[0] - OVERRUN, ANGLES[-1] + OVERRUN
    at, values, ramps = [0.0], [lowest], []
    for _ in range(CYCLES):
        for phase, places in (("rise", [*ANGLES, highest]), ("fall", [*reversed(ANGLES), lowest])):
            for there in places:
                ramps.append((at[-1], there, values[-1], phase))
                at.append(at[-1] + abs(there - values[-1]) / SPEED)
                values.append(there)
                if there not in (lowest, highest):
                    at.append(at[-1] + REST)
                    values.append(there)
    t = np.arange(round(at[-1] * RATE) + 1) / RATE
    return t, np.interp(t, at, values), ramps


def _read(cause: str, amount: float, angle: Array, torque: Array, share: Array, chance: np.random.Generator) -> dict:
    """Angle and torque as the bench reads them; `share` of all trials that is gone."""
    since = share * len(LEVELS) ** 2 * REPEATS
    if cause == "cell-drift":
        torque = torque + amount * share
    elif cause == "torque-lag":
        torque = lagged(torque, amount, RATE)
    elif cause == "shaking":
        torque = torque + amount * np.sin(2 * np.pi * 0.7 * np.arange(len(torque)) / RATE + chance.uniform(0, 6.28))
    elif cause == "cell-jump":
        torque = torque + amount * (since > 7.4)
    elif cause == "angle-offset":
        angle = angle + amount
    elif cause == "angle-scale":
        angle = angle * (1 + amount)
    elif cause == "backlash":
        angle = angle + 0.5 * amount * _slid_play(angle, amount)
    return {"angle": angle, "torque": torque}


def _slid_play(angle: Array, amount: float) -> Array:
    """Which side of its play a loose encoder is on, from -1 to 1: it comes after the joint."""
    off, found = 0.0, np.empty_like(angle)
    for n, move in enumerate(np.diff(angle, prepend=angle[0]).tolist()):
        off = max(-1.0, min(1.0, off - 2 * move / amount))
        found[n] = off
    return found


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials with a cause at `size` times its full size; chance by the seed.

    cell-drift, cell-jump
        The zero of the torque cell goes evenly over all trials; jumps in one.
    torque-lag
        The torque has a filter of first order.
    backlash, angle-offset, angle-scale
        The encoder is loose; its zero is off; it reads too much. The drive goes where it is sent.
    gives-way, gives-way-unseen
        The regulators are worse by so many times and slower by ten; the second is not in the record.
    slip
        In one trial the mount of muscle 1 gives way, and stays there.
    creep
        Each muscle's force goes on changing after a motion, with three time constants.
    unequal, eccentric, friction, not-linear, slack
        Of the joint: muscle 2 is weaker, the pulley is no circle, its bearing rubs, the pull is bent over the pressure, a
        muscle goes slack.
    pressure-scale
        The second pressure reads too much, and its regulator goes by its own sensor.
    shaking
        The building shakes the cell.
    """
    amount = size * FULL[cause]
    joint, chance = Joint.of(cause, amount), np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    t, commanded, ramps = _course()
    settled = lagged(lagged(commanded, 0.02, RATE), 0.02, RATE)
    order = [(P, repeat) for repeat in range(REPEATS) for P in product(LEVELS, LEVELS)]
    trials, slipped = [], 0.0
    whole = len(order) * (float(t[-1]) + PAUSE)
    slips = int(chance.integers(4, 14)) if cause == "slip" else -1
    for number, (P, repeat) in enumerate(order):
        since = number * (float(t[-1]) + PAUSE)
        turning = np.gradient(settled, t)
        bad = 1 + amount if cause.startswith("gives-way") else 1.0
        slow = COMES * (10.0 if cause.startswith("gives-way") else 1.0)
        gave = lagged(bad * GIVES * turning, slow, RATE)
        inside = [P[0] - gave, P[1] + gave]
        if number == slips:
            slipped = amount
        gone = slipped * (t > chance.uniform(0.2, 0.8) * t[-1]) if number == slips else np.full(len(t), slipped)
        forces = []
        for n, sign in enumerate((1, -1)):
            k = joint.contraction(settled, sign) - (gone if n == 0 else 0.0)
            still = joint.pull(k, inside[n], n == 1) - load(P[n]) * _slid(k)
            if cause == "creep":
                still = still + amount * sum(still - lagged(still, late, RATE) for late in (0.5, 5.0, 50.0))
            forces.append(np.maximum(0.0, still))
        torque = joint.radius(settled) * (forces[0] - forces[1]) - DAMPING * turning
        if cause == "friction":
            torque = torque - amount * _slid(np.degrees(settled))
        torque = torque + SCATTER * chance.standard_normal()
        share = (since + t) / whole
        read = _read(cause, amount, settled, torque, share, chance)
        seen = [P[0] - gave, P[1] + gave] if cause != "gives-way-unseen" else [np.full(len(t), one) for one in P]
        if cause == "pressure-scale":
            seen[1] = seen[1] * (1 + amount)
        read |= {"pressure_1": seen[0], "pressure_2": seen[1]}
        channels = {name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in read.items()}
        commands = tuple(Ramp(since + when, "angle", to, fro, phase, SPEED) for when, to, fro, phase in ramps)
        point = {"pressure_1": P[0], "pressure_2": P[1], "lowest_angle": ANGLES[0] - OVERRUN,
                 "highest_angle": ANGLES[-1] + OVERRUN, "cycles": float(CYCLES)}  # fmt: skip
        trials.append(Trial(point, repeat, since + t, channels, commands))
    return trials
