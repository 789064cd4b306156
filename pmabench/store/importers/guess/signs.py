"""Recognises the kind of test, and how a file is divided into trials: by pauses, steps, sines or trial numbers.

Knows no kind of test: each kind names the sign for which it is proposed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmabench.store.importers import motion
from pmabench.store.importers.found import correlation
from pmabench.store.importers.guess.columns import METRES, STILL, Guess, Proposal
from pmabench.store.records import Array

LONG_PAUSE = 2.0
"""Pause of a log that separates parts [s]: logging was switched off."""
STEADY = 0.15
"""Largest range of a steady pressure, as a share of it: a regulator lets it vary while the muscle is stretched."""
TOGETHER = 0.5
"""Least correlation of force and length at a steady pressure; hysteresis or damping lowers it."""
PURE = 0.06
"""Largest residual of a pure sine (`motion.Wave.left`)."""
MOVES = 0.1
"""Largest motion of a held length, as a share of the distance between the lengths."""
HELD = 0.02
"""Largest range of a length that counts as held, as a share of the length."""
FEWEST = 50
"""Least number of samples in which cycles are searched."""


@dataclass(frozen=True)
class Sign:
    """A recognised pattern of a test, and the division into trials that follows from it."""

    name: str
    trials: dict[str, str]
    """Entries of the map's `trials`, as text."""
    reason: str
    smallest_of: str = "pressure_command"
    """Role of the channel in whose unit `smallest` of the trials is given."""
    frequency: float = 0.0
    """Frequency of a command that is one sine throughout [Hz]; else 0."""


def choose_kind(guess: Guess) -> None:
    """Choose the kind of test of the first sign that belongs to one, and its division into trials."""
    for sign in signs(guess):
        kind = next((name for name, test in guess.kinds.items() if test.shown == sign.name), "")
        if kind:
            guess.kind, guess.trials = kind, sign.trials
            guess.smallest_of, guess.frequency = sign.smallest_of, sign.frequency
            guess.reasons.setdefault("trials", []).extend(sign.reason.split("\n"))
            if (trial := guess.role("trial")) is not None and not guess.test.recording and np.ptp(trial.good) > 0:
                guess.trials = {"by": "column"}
                guess.reasons["trials"].append(f'"{trial.name}" numbers the trials')
            return


def signs(guess: Guess) -> Iterator[Sign]:
    """Signs that a file shows, the surest first: numbered trials, pauses, a held length, a sine, steps."""
    command, displacement = guess.role("pressure_command"), guess.role("displacement")
    if guess.role("trial") is not None and command is not None and edge(command.values) > 0:
        reason = "the command goes in steps, and a column numbers the trials"
        yield Sign("numbered trials", {"by": "column"}, reason)
    pulls = displacement is not None and guess.role("force") is not None
    still = displacement is not None and pulls and _held(displacement, guess.role("pressure"))
    parts, trials, reason = _between_pauses(guess, displacement)
    if pulls and len(parts) > 2 and (still or _at_lengths(parts)):
        yield Sign("pauses", trials, f"{reason}: parts at set contractions")
    if displacement is None or still:
        reason = "the length is held" if still else "no displacement"
        reason += ": force over pressure at one contraction in each file"
        if guess.role("pressure") is None:
            reason = "no pressure was found, and without one this is no test of a muscle"
        cycles, trials = count(guess, "ramp"), {"by": "file"}
        if cycles > 1:
            reason += f"\nthe pressure rises and falls {cycles} times: each is a trial"
            trials = {"by": "ramp", "smallest": f"{5 * share(guess, 'pressure'):.3g}"}
        yield Sign("held length", trials, reason, "pressure" if cycles > 1 else "pressure_command")
    yield from filter(None, (_held_lengths(guess), _driven(guess)))
    if (sine := _sine_of(guess)) > 0:
        reason = f"the command is a sine of {sine:.3g} Hz ({sine * 2 * np.pi:.3g} rad/s)"
        yield Sign("sine", {"by": "file"}, reason, frequency=sine)
    if command is not None and (step := edge(command.values)) > 0:
        reason = "the command goes in steps: each is a trial"
        yield Sign("steps", {"by": "step", "smallest": f"{step:.3g}", "lead": _lead(guess)}, reason)
    if (waves := count(guess, "sine")) > 0:
        of = "pressure_command" if command is not None else "pressure"
        reason = f"{waves} stretches of one frequency each, found in the {of.replace('_', ' ')}"
        yield Sign("sine", {"by": "sine", "smallest": f"{share(guess, of):.3g}"}, reason, of)
    if command is None and (steps := count(guess, "step")) > 0:
        reason = "no command was recorded; the measured pressure makes "
        reason += f"{steps} steps: each is a trial, without dead time"
        trials = {"by": "step", "smallest": f"{share(guess, 'pressure'):.3g}", "lead": _lead(guess)}
        yield Sign("steps", trials, reason, "pressure")
    yield Sign("steps", {"by": "file"}, "neither steps nor sines were found: the file is one trial")


def _held(column: Proposal, pressure: Proposal | None) -> bool:
    """Whether a length is held: small range, and not correlated with the pressure."""
    x = column.good
    if len(x) < 3:
        return False
    low, high = (float(value) for value in np.quantile(x, [0.01, 0.99]))
    if high - low == 0:
        return True
    together = 0.0 if pressure is None else correlation(column.values, pressure.values)
    still = STILL / METRES[column.unit] if column.unit in METRES else 0.0
    return high - low < max(still, HELD * max(abs(low), abs(high))) and abs(together) < 0.5


def _rows(guess: Guess, *roles: str) -> list[Array]:
    """Time [s] and these channels, shape (n,), where all are finite and the time advances; empty without one."""
    columns, t = [guess.role(role) for role in roles], guess.seconds
    if t is None or None in columns:
        return []
    every = [column.values for column in columns if column is not None]
    good = np.logical_and.reduce([motion.later(t), *map(np.isfinite, every)])
    return [values[good] for values in (t, *every)]


def _held_lengths(guess: Guess) -> Sign | None:
    """The sign of pressure cycles at several held lengths; None where the file does not show it."""
    rows, pressure = _rows(guess, "displacement", "pressure"), guess.role("pressure")
    if not rows or guess.role("force") is None or guess.role("pressure_command") or pressure is None:
        return None
    t, values, P = rows
    smallest = 5 * share(guess, "pressure")
    if _steady(pressure.good) or smallest <= 0 or len(t) < FEWEST:
        return None
    cycles = motion.cycles(t, P, smallest)
    if not _at_lengths([values[(t >= cycle.begin) & (t <= cycle.end)] for cycle in cycles]):
        return None
    reason = f"the pressure rises and falls {len(cycles)} times, at lengths that are held: each is a trial"
    return Sign("held lengths", {"by": "ramp", "smallest": f"{smallest:.3g}"}, reason, "pressure")


def _at_lengths(parts: Sequence[Array]) -> bool:
    """Whether there are at least two parts, each with a held length, compared with the distance between the lengths."""
    if len(parts) < 2 or min(map(len, parts)) < 3:
        return False
    apart = float(np.ptp([np.median(part) for part in parts]))
    return max(float(np.ptp(np.quantile(part, [0.05, 0.95]))) for part in parts) <= MOVES * apart


def _between_pauses(guess: Guess, column: Proposal | None) -> tuple[list[Array], dict[str, str], str]:
    """Finite values of a column between long pauses of the log, the trials that these make, and the reason."""
    if column is None or guess.seconds is None:
        return [], {}, ""
    steps = np.diff(guess.seconds)
    at = np.flatnonzero(steps > LONG_PAUSE)
    shortest = steps[at].min(initial=np.inf)
    reason = f"the log pauses {len(at)} times for {shortest:.2g} s and longer"
    parts = [part[np.isfinite(part)] for part in np.split(column.values, at + 1)]
    return parts, {"by": "gap", "longer_than": f"{0.6 * shortest:.2g} s"}, reason


def _driven(guess: Guess) -> Sign | None:
    """The sign of a length driven up and down at one or several constant pressures; None where it is not shown.

    The force then changes with the length at equal pressure, and the length more often than the pressure.
    """
    pressure = guess.role("pressure")
    rows = _rows(guess, "displacement", "force", *(["pressure"] if pressure is not None else []))
    if not rows or guess.role("pressure_command") is not None:
        return None
    steady = pressure is None or _steady(pressure.good)
    steps = 0 if steady else count(guess, "step")
    trials = {"by": "level", "smallest": f"{share(guess, 'pressure'):.3g}"} if steps else {"by": "file"}
    parts, gaps, _ = _between_pauses(guess, pressure)
    if not steps and len(parts) > 1 and all(len(part) and _steady(part) for part in parts):
        steps, trials = len(parts) - 1, gaps
    smallest = 5 * share(guess, "displacement") / (2 if steps else 1)
    t, values, pull, *P = rows
    if not (steps or steady) or smallest <= 0 or len(t) < FEWEST:
        return None
    if len(motion.cycles(t, values, smallest)) <= 1 + steps:
        return None
    by = np.column_stack([np.ones(len(t)), *P])
    left = [one - by @ np.linalg.lstsq(by, one, rcond=None)[0] for one in (values, pull)]
    if abs(correlation(*left)) < TOGETHER:
        return None
    pure = max((wave.left for wave in motion.waves(t, values, smallest)), default=1.0) < PURE
    reason = f"the length goes through {'sines' if pure else 'cycles'} at "
    reason += f"{steps + 1} pressures" if steps else "one pressure"
    reason += " while the force falls and rises: it is driven"
    return Sign("length sine" if pure else "length ramps", trials, reason, "pressure")


def _steady(P: Array) -> bool:
    """Whether a pressure, shape (n,), is held throughout."""
    low, middle, high = np.quantile(P, [0.02, 0.5, 0.98])
    return bool(high - low <= STEADY * abs(middle))


def _lead(guess: Guess) -> str:
    """Time before its step at which a trial begins: 1 s, or 50 samples if that is longer."""
    return f"{max(1.0, 50.0 / (guess.rate[0] / 0.7)):.2g} s"


def share(guess: Guess, role: str) -> float:
    """A tenth of the range of a channel, in its own unit; 0 without the channel."""
    column = guess.role(role)
    if column is None or not len(column.good):
        return 0.0
    return 0.1 * float(np.ptp(np.quantile(column.good[~lone(column.good)], [0.005, 0.995])))


def lone(values: Array) -> NDArray[np.bool_]:
    """Mask of samples far from their neighbours, such as sentinels and spikes, shape (n,); for finite values."""
    if len(values) < 9:
        return np.zeros(len(values), dtype=bool)
    around = motion.medians(values, 9)
    return np.asarray(np.abs(values - around) > 0.25 * float(np.ptp(around)))


def count(guess: Guess, what: str) -> int:
    """Number of steps, ramps or sines of the pressure (for sines, of its command if there is one)."""
    column = (guess.role("pressure_command") if what == "sine" else None) or guess.role("pressure")
    smallest = share(guess, column.role) if column is not None else 0.0
    if column is None or guess.seconds is None or len(guess.seconds) < FEWEST or smallest <= 0:
        return 0
    t, values = _rows(guess, column.role)
    good = (values != 0) | (column.unit != "mA")
    if good.sum() < FEWEST:
        return 0
    t, values = t[good], values[good]
    t, values = t[~lone(values)], values[~lone(values)]
    if what == "ramp":
        return len(motion.cycles(t, values, 5 * smallest))
    return len(motion.waves(t, values, smallest) if what == "sine" else motion.levels(t, values, smallest))


def _sine_of(guess: Guess) -> float:
    """Frequency [Hz] of a command that is a single sine; 0 where it is not, or there is none."""
    if not (rows := _rows(guess, "pressure_command")):
        return 0.0
    t, values = rows
    return motion.only_sine(t[~lone(values)], values[~lone(values)])


def edge(values: Array) -> float:
    """Half of the smallest usual step of a command that rests at levels; 0 where it is not such a command."""
    good = values[np.isfinite(values)]
    moves = np.abs(np.diff(good))
    big = moves > 0.02 * float(np.ptp(good)) if len(good) else moves > 0
    return 0.5 * float(np.quantile(moves[big], 0.05)) if 0 < big.sum() < 0.1 * len(good) else 0.0
