"""A driven joint of two muscles in closed form, and what its sensors and regulators may get wrong.

Torques are those of paper 3 on a pulley; each hysteresis goes over after a turn as exp(-way/w), exactly, from sample
to sample. Nothing of pmabench's models is in it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

RADIUS, LENGTH, MIDDLE = 0.025, 0.2, 0.1
HALF, W = 30.0, 0.006
"""Half gap of a muscle [N], and the contraction on which a turn fades."""


def force_by_pressure(eps):
    """Paper 3, eqs. 8-10: [m2]."""
    angle = math.radians(25)
    return math.pi / 4 * 0.02**2 * (3 * (1 - eps) ** 2.6 / math.tan(angle) ** 2 - 1 / math.sin(angle) ** 2)


def torque(angle, P1, P2):
    """Without hysteresis [N m]."""
    one, two = MIDDLE + RADIUS * angle / LENGTH, MIDDLE - RADIUS * angle / LENGTH
    rubber = [800.0 * eps * (eps - 0.22) / (eps + 0.04) for eps in (one, two)]
    return RADIUS * (force_by_pressure(one) * P1 + rubber[0] - force_by_pressure(two) * P2 - rubber[1])


def stiffness(angle, P1, P2):
    """Minus its slope [N m/rad]."""
    return (torque(angle - 1e-5, P1, P2) - torque(angle + 1e-5, P1, P2)) / 2e-5


def hysteresis(angle, half, w):
    """Of both muscles along a way of the joint [N m]."""
    found, now = np.empty(len(angle)), 2 * RADIUS * half  # it came down to its lowest angle
    steps = np.diff(angle, prepend=angle[0])
    kept, end = np.exp(-np.abs(steps) * RADIUS / LENGTH / w), -2 * RADIUS * half * np.sign(steps)
    for n, (share, to) in enumerate(zip(kept, end, strict=True)):
        now = to + (now - to) * share
        found[n] = now
    return found


@dataclass(frozen=True)
class Faults:
    """What is wrong at the bench; as it is, nothing."""

    reached: float = 1.0
    """Of the commanded pressures."""
    dragged: float = 0.0
    """Pressure that a muscle has more while the joint squeezes it [Pa]."""
    zero: float = 0.0
    scale: float = 0.0
    """Of the encoder [rad] and [1]."""
    second: tuple[float, float] = (0.0, 1.0)
    """Half gap [N] and way of another hysteresis."""
    play: float = 0.0
    """Between the drive, where the encoder is, and the joint [rad]."""
    loaded: float = 0.0
    """Of the same, where the torque holds the joint at one flank or the other [rad]."""
    bearing: float = 0.0
    """Friction [N m]."""
    drift: float = 0.0
    """Of the torque's zero over the run [N m]."""
    creep: tuple[float, float] = (0.0, 1.0)
    """A part of the stiffness [N m/rad] that yields, and its time [s]."""
    droop: float = 0.0
    """Pressure that a muscle loses where the joint squeezes it, and gains where it stretches it [Pa/rad]."""
    clip: float = np.inf
    """Largest torque that the sensor reads, either way [N m]."""
    step: float = 0.0
    """In which the torque is read [N m]; then without noise."""


def commanded(trial):
    """Angle by the commands [rad]."""
    t, y = [-1e9], [trial.commands[0].before]
    for c in (c for c in trial.commands if c.output == "angle"):
        t += [c.t, c.t + abs(c.value - c.before) / c.data["rate"]]
        y += [c.before, c.value]
    return np.interp(trial.t, t, y)


def behind(angle, play):
    """The joint in its play, held by friction."""
    found, now = np.empty(len(angle)), angle[0]
    for n, drive in enumerate(angle):
        now = min(max(now, drive - play / 2), drive + play / 2)
        found[n] = now
    return found


def measured(run, faults=Faults(), seed=1):
    """The run as such a bench would have recorded it."""
    rng = np.random.default_rng(seed)
    begin, end = run.trials[0].t[0], run.trials[-1].t[-1]
    return replace(run, trials=tuple(_trial(one, faults, rng, (one.t - begin) / (end - begin)) for one in run.trials))


def _trial(trial, faults, rng, since):
    drive = lfilter([0.4], [1, -0.6], commanded(trial), zi=[0.6 * commanded(trial)[0]])[0]
    joint = behind(drive, faults.play) if faults.play else drive
    for _ in range(8 if faults.loaded else 0):
        held = torque(joint, trial.point["pressure_1"], trial.point["pressure_2"]) + hysteresis(joint, HALF, W)
        joint = 0.5 * joint + 0.5 * (drive + 0.5 * faults.loaded * np.tanh(held / 0.3))
    way = np.sign(np.gradient(joint))
    P = [faults.reached * trial.point[f"pressure_{n}"] + sign * faults.dragged * way for n, sign in ((1, 1), (2, -1))]
    P = [one - sign * faults.droop * joint for one, sign in zip(P, (1, -1), strict=True)]
    pull = torque(joint, *P) + hysteresis(joint, HALF, W) + hysteresis(joint, *faults.second)
    if faults.bearing:
        pull = pull + faults.bearing / (2 * RADIUS) * hysteresis(joint, 1.0, 0.002 * RADIUS / LENGTH)
    K, tau = faults.creep
    share = math.exp(-float(np.median(np.diff(trial.t))) / tau)
    pull = pull - lfilter([K], [1, -share], np.diff(joint, prepend=joint[0])) + faults.drift * since
    pull = np.clip(pull, -faults.clip, faults.clip)
    noisy = pull + rng.normal(0, 0.003, len(pull))
    channels = {
        "torque": np.round(pull / faults.step) * faults.step if faults.step else noisy,
        "angle": (1 + faults.scale) * drive + faults.zero + rng.normal(0, 1e-5, len(drive)),
        "pressure_1": P[0] + rng.normal(0, 60, len(pull)),
        "pressure_2": P[1] + rng.normal(0, 60, len(pull)),
    }
    return replace(trial, channels={**trial.channels, **channels})
