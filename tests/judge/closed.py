"""Campaigns of a muscle that is filled, shut off and stretched and contracted slowly, sound or with a known fault.

The air shut in obeys P V = m R T: its mass leaks into the room in proportion to the gauge pressure, its temperature
falls as it expands and returns to that of the wall through one time constant.
"""

from __future__ import annotations

from math import cos, exp, pi, sin

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

LENGTH, DIAMETER, BRAID, BULGE = 0.28, 26e-3, 0.43, 2.3
"""Length, inner diameter [m] and braid angle [rad] at rest; exponent of the change of the braid angle's tangent."""
TUBE, ROOM = 6e-6, 98.4e3
"""Volume of the line [m3], pressure of the room [Pa absolute]."""
RATIO = 1.4
"""Of the specific heats of air."""
LEAK = 5e-5
"""Share of the gauge pressure that is lost a second at constant volume [1/s]."""
HEAT = 0.05
"""Time in which sound air takes the temperature of the wall [s]."""
COOLS = 15.0
"""Time in which a wall that the filling warmed takes the temperature of the room [s]."""
WARM = 295.0
"""Temperature of the room [K]."""
PRESSURES, REPEATS = (250e3, 450e3), 2
FAR, SPEED, REST, CYCLES, EVERY = 32e-3, 2e-3, 3.0, 2, 4e-3
"""[m], [m/s], [s], 1, [m]"""
RATE, FINE = 50.0, 4
PAUSE = 20.0
NOISE = {"pressure": 200.0, "displacement": 5e-6}
KNOWN = {"volume": 0.004, "dead": 0.3e-6, "room": 0.3e3}
"""Half widths of what is measured beforehand, within which it is off: share of the volume at the start; m3; Pa."""
FULL = {
    "clean": 0.0, "leak-changes": 1.5e-3, "slow-heat": 4.0, "cooling": 3.0, "warming": 3.0, "sensor-lag": 0.5,
    "other-room": 8e3, "other-curve": 0.01,
}  # fmt: skip
"""Cause -> its full size: 1/s from the middle of a trial on; s; K at the start; K over a trial; s; Pa; share of the
volume."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")


def volume(x: Array, other: float = 0.0) -> Array:
    """Volume inside the muscle [m3] at contractions [m]; `other`: by which share a wave makes it another curve."""
    share = x / LENGTH
    shape = 1 / sin(BRAID) ** 2 - (1 - share) ** BULGE * cos(BRAID) ** 2 / sin(BRAID) ** 2
    free = pi / 4 * DIAMETER**2 * LENGTH
    return np.asarray(free * (shape * (1 - share) + other * np.sin(2 * pi * x / FAR)))


def truth(cause: str, size: float) -> Truth:
    """Volumes at the contractions that are asked for; the coefficients where the curve has them."""
    other = size * FULL[cause] if cause == "other-curve" else 0.0
    places = EVERY * np.arange(round(FAR / EVERY) + 1)
    right: Truth = {("V", "", float(x)): (float(volume(x, other)),) * 2 for x in places}
    if not other:
        for symbol, value in (("D_0", DIAMETER), ("theta_0", BRAID), ("alpha", BULGE)):
            right[symbol, "", 0.0] = (value, value)
    return right


def _air(P: float, t: Array, grown: Array, cause: str, amount: float) -> Array:
    """Gauge pressure [Pa] over time, of air shut in at P with the volume `grown` [1] of that at the start."""
    step = float(t[1] - t[0])
    heat = amount if cause == "slow-heat" else HEAT
    share = np.asarray(t / t[-1])
    wall = np.full(len(t), WARM)
    if cause == "cooling":
        wall = WARM + amount * np.exp(-t / COOLS)
    elif cause == "warming":
        wall = WARM + amount * share
    leak = np.where(share > 0.5, LEAK + (amount if cause == "leak-changes" else 0.0), LEAK)
    follow = 1 - exp(-step / heat)
    mass, kelvin = 1.0, float(wall[0])
    scale = (P + ROOM) / kelvin
    found = np.empty(len(t))
    found[0] = P
    for n in range(1, len(t)):
        kelvin *= (float(grown[n - 1]) / float(grown[n])) ** (RATIO - 1)
        kelvin += follow * (float(wall[n]) - kelvin)
        mass -= step * float(leak[n]) * found[n - 1] / (P + ROOM)
        found[n] = mass * scale * kelvin / float(grown[n]) - ROOM
    return found


def campaign(cause: str, size: float, seed: int) -> tuple[list[Trial], dict[str, float]]:
    """The trials with a cause at `size` times its full size, and what was measured beforehand; chance by the seed.

    leak-changes
        From the middle of each trial on it leaks faster.
    slow-heat
        The air takes the temperature of the wall in this time only.
    cooling, warming
        The wall is warm from the filling and cools; the room grows warmer during the trial.
    sensor-lag
        The pressure has a filter of first order with this time constant.
    other-room
        The barometer reads that much too high (too low with odd seeds).
    other-curve
        A wave in the volume over contraction.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    stroke = FAR / SPEED
    begins = REST + (stroke + REST) * np.arange(2 * CYCLES)
    corners = np.sort(np.concatenate([[0.0], begins, begins + stroke]))
    t = np.arange(round((begins[-1] + stroke + REST) * RATE) * FINE + 1) / (RATE * FINE)
    x = np.interp(t, corners, [0.0, *np.concatenate([[0.0, FAR], [FAR, 0.0]] * CYCLES)])
    other = amount if cause == "other-curve" else 0.0
    start = float(volume(np.zeros(1), other)[0])
    grown = (volume(x, other) + TUBE) / (start + TUBE)
    trials = []
    for number, P in enumerate(np.repeat(PRESSURES, REPEATS)):
        inside = _air(float(P), t, grown, cause, amount)
        if cause == "sensor-lag":
            inside = lagged(inside, amount, RATE * FINE)
        read = {
            name: one[::FINE] + NOISE[name] * chance.standard_normal(len(t[::FINE]))
            for name, one in (("pressure", inside), ("displacement", x))
        }
        since = number * (float(t[-1]) + PAUSE)
        commands = tuple(
            Ramp(since + float(at), "displacement", FAR * (1 - back), FAR * back, "closed", SPEED)
            for index, at in enumerate(begins)
            for back in [index % 2]
        )
        point = {"pressure": float(P), "lower": 0.0, "upper": FAR, "speed": SPEED}
        trials.append(Trial(point, number % REPEATS, since + t[::FINE], read, commands))
    off = chance.uniform(-0.8, 0.8, 3)
    wrong = (1 - 2 * (seed % 2)) * amount if cause == "other-room" else 0.0
    settings = {
        "reference_volume": start * (1 + KNOWN["volume"] * off[0]), "reference_half": start * KNOWN["volume"],
        "dead_volume": TUBE + KNOWN["dead"] * off[1], "dead_half": KNOWN["dead"],
        "atmosphere": ROOM + KNOWN["room"] * off[2] + wrong, "atmosphere_half": KNOWN["room"],
        "exponent": 1.0, "every": EVERY, "rest": REST, "length": LENGTH,
    }  # fmt: skip
    return trials, settings
