"""A muscle at set lengths that is filled through a mass flow meter and emptied, sound or with one fault of known size.

The bladder is a barrel: its radius is that of a parabola between two ferrules. The air is a gas of one temperature that
exchanges heat with the wall; steps of it are taken exactly in the mass, by Euler's rule in the temperature. Left out
is what no such record can show: a meter or a gauge that reads too much, and a hose that is longer than was said.
"""

from __future__ import annotations

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

R_AIR, ROOM, WARM = 287.05, 98.6e3, 294.5
"""[J/(kg K)], [Pa absolute], [K]"""
LENGTH, RADIUS, BELLY = 0.22, 9e-3, 11.5e-3
"""[m]; radius at the ferrules, and what the middle has more at full stroke [m]."""
STROKE = 45e-3
HOSE, HOSE_HALF, WARM_HALF = 11e-6, 0.25e-6, 1.5
"""Volume between meter and muscle [m3] and what it is known to; what the temperature is known to [K]."""
CONTRACTIONS, REPEATS = (0.0, 0.015, 0.03, 0.045), 2
TOP, RAMP, SETTLE, ZERO, HOLD, PAUSE = 450e3, 12e3, 2.0, 5.0, 5.0, 15.0
RATE, FINE = 50.0, 2
METER = 0.08
"""Time constant of the meter [s]."""
RANGE = 5 * 1.185e-3 / 60
"""Of the meter [kg/s]."""
HEAT = 0.15
"""Time in which the air takes the temperature of the wall [s]."""
NOISE = {"pressure": 300.0, "flow": 2e-3 * RANGE}
SCATTER = 5e-4
"""Between trials, standard deviation of the volume as a share."""
FULL = {
    "clean": 0.0, "zero-off": 0.02, "zero-drift": 0.01, "zero-jump": 0.01, "warms-up": 0.01, "slow-meter": 2.0,
    "one-way": 0.01, "clips": 0.08, "leak": 2e-6, "leak-above": 2e-6, "elastic": 0.08, "slow-heat": 8.0,
    "room-warms": 6.0, "pressure-late": 1.0, "slip": 3e-3, "creep": 0.03,
}  # fmt: skip
"""Cause -> its full size: shares of the range (off; over a trial; once during the ramp; with the flow); s;
share of the range that is taken off before what is below 0 is cut; shares by which its end is below 30 % of the range; kg/s at the top; the same above
half of it; share of the volume; s; K over a trial; s; m; share of the volume in a decade of time."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")


def volume(x: Array | float) -> Array:
    """Inside the muscle [m3] at contractions [m]: pi times the integral of the square of a parabolic radius."""
    more = BELLY * np.sqrt(np.maximum(np.asarray(x), 0.0) / STROKE)
    mean_square = RADIUS**2 + 2 * RADIUS * more * 2 / 3 + more**2 * 8 / 15
    return np.asarray(np.pi * (LENGTH - np.asarray(x)) * mean_square)


def truth(cause: str, size: float) -> Truth:
    """Volumes, of an elastic bladder any between no pressure and all; of a muscle that slips both."""
    amount = size * FULL[cause]
    right: Truth = {}
    for x in CONTRACTIONS:
        ends = [float(volume(x))]
        if cause == "elastic":
            ends.append(ends[0] * (1 + amount))
        if cause == "creep":
            ends.append(ends[0] * (1 + 2.0 * amount))
        if cause == "slip":
            ends.append(float(volume(max(0.0, x - amount))))
        right["V", "", x] = (min(ends), max(ends))
        if cause not in ("elastic", "creep", "slip", "leak", "leak-above", "slow-heat", "room-warms"):
            q = (ends[0] + HOSE) * RAMP / (R_AIR * WARM)
            right["q", "", x] = (q, q)
    return right


def _mass(P: Array, V: Array, wall: Array, heat: float, step: float) -> Array:
    """Of the air inside [kg] along its gauge pressure and volume."""
    at, found = float(wall[0]), np.empty_like(P)
    follow = -np.expm1(-step / heat)
    for n in range(len(P)):
        if n:
            pressed = (P[n] + ROOM) / (P[n - 1] + ROOM)
            # what comes in has the wall's temperature; what was there is compressed, and cools to it
            share = 1.0 / pressed if pressed > 1 else 1.0
            at *= 1 + share * (pressed ** (0.4 / 1.4) - 1)
            at += follow * (float(wall[n]) - at)
        found[n] = (P[n] + ROOM) * V[n] / (R_AIR * at)
    return found


def _read(cause: str, amount: float, flow: Array, t: Array, begins: float, chance: np.random.Generator) -> Array:
    """What the meter makes of the flow [kg/s]."""
    slow = lagged(flow, amount if cause == "slow-meter" else METER, RATE * FINE)
    over = slow / RANGE
    if cause == "zero-off":
        slow = slow + amount * RANGE
    elif cause == "zero-drift":
        slow = slow + amount * RANGE * t / t[-1]
    elif cause == "zero-jump":
        slow = slow + amount * RANGE * (t > begins + chance.uniform(5, 25))
    elif cause == "warms-up":
        slow = slow + amount * RANGE * lagged((np.abs(over) > 0.02).astype(float), 6.0, RATE * FINE)
    elif cause == "one-way":
        slow = np.maximum(slow - 0.3 * amount * RANGE, 0.0)
    return slow


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials with a cause at `size` times its full size; chance by the seed.

    zero-off, zero-drift, zero-jump, warms-up
        The zero of the meter is off; goes over a trial; jumps while it fills; is off only while air flows.
    slow-meter, one-way, clips
        The meter is slow; shows no flow back, nor a zero below 0; has an end.
    leak, leak-above
        Air leaks in proportion to the pressure; only above half of it.
    elastic, creep
        The bladder grows with the pressure; goes on growing.
    slow-heat, room-warms
        The air is slow to take the temperature of the wall; the room grows warmer.
    pressure-late
        The pressure comes late.
    slip
        The mount gives way while it fills, by so much at full pressure.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    way = TOP / RAMP
    corners = np.cumsum([0.0, SETTLE + ZERO, way, HOLD, way, ZERO + SETTLE])
    t = np.arange(round(corners[-1] * RATE) * FINE + 1) / (RATE * FINE)
    wanted = np.interp(t, corners, [0.0, 0.0, TOP, TOP, 0.0, 0.0])
    P = lagged(lagged(wanted, 0.06, RATE * FINE), 0.06, RATE * FINE)
    share = P / TOP
    trials = []
    for number, (repeat, x) in enumerate((repeat, x) for repeat in range(REPEATS) for x in CONTRACTIONS):
        since = number * (float(t[-1]) + PAUSE)
        at = np.maximum(0.0, x - amount * np.maximum.accumulate(share)) if cause == "slip" else np.full(len(t), x)
        V = volume(at) * (1 + SCATTER * chance.standard_normal())
        if cause == "elastic":
            V = V * (1 + amount * share)
        if cause == "creep":
            V = V * (1 + amount * sum(lagged(share, late, RATE * FINE) for late in (4.0, 40.0)))
        wall = WARM + (amount * t / t[-1] if cause == "room-warms" else 0.0) * np.ones(len(t))
        heat = amount if cause == "slow-heat" else HEAT
        inside = _mass(P, V, wall, heat, 1 / (RATE * FINE)) + (P + ROOM) * HOSE / (R_AIR * WARM)
        leaks = np.zeros(len(t))
        if cause == "leak":
            leaks = amount * share
        elif cause == "leak-above":
            leaks = amount * np.maximum(0.0, 2 * share - 1)
        flow = _read(cause, amount, np.gradient(inside, t) + leaks, t, float(corners[1]), chance)
        seen = np.interp(t - amount, t, P) if cause == "pressure-late" else P
        few = t[::FINE]
        read = {
            name: one[::FINE] + NOISE[name] * chance.standard_normal(len(few))
            for name, one in (("pressure", seen), ("flow", flow))
        }
        if cause == "one-way":
            read["flow"] = np.maximum(read["flow"], 0.0)
        if cause == "clips":
            read["flow"] = np.clip(read["flow"], -(0.3 - amount) * RANGE, (0.3 - amount) * RANGE)
        read |= {"displacement": at[::FINE] * 0 + x, "force": 2e-3 * seen[::FINE]}
        commands = (
            Ramp(since + float(corners[1]), "pressure", TOP, 0.0, "fill", RAMP),
            Ramp(since + float(corners[3]), "pressure", 0.0, TOP, "empty", RAMP),
        )
        trials.append(Trial({"contraction": x}, repeat, since + few, read, commands))
    return trials


def settings() -> dict[str, object]:
    """What is known beforehand, as the plan of such a test says it."""
    return {
        "dead": HOSE, "dead_half": HOSE_HALF, "temperature": WARM + 0.5, "temperature_half": WARM_HALF,
    }  # fmt: skip
