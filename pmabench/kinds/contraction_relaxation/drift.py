"""What drifted during a campaign and its effect on the fit: specimen, zeros, the force cell against the weights.

The specimen by its reference trials, a zero by the check at the end of a run. Nobody knows what drifted in a specimen
whose stroke did: its compliance or its force; nor when a zero went. Each cause is fitted both ways, the larger counts.

At a plateau nothing moves and the cell reads the weight; before a trial the weight lies on its support and the cell
reads the same in every trial. What both scatter by is seen in them, so the friction of a pulley needs no assumption.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.shared.trials import compared
from pmabench.kinds.contraction_relaxation.pooled import Solved
from pmabench.kinds.contraction_relaxation.segments import Gate, Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign, settled, strokes
from pmabench.store.records import Array, RunData, TrialData

SPECIMEN = "drift of the specimen"
NO_REFERENCE = "no reference trial was done again"
NO_CHECK = "the record tells no zero at the end"


@dataclass(frozen=True, eq=False)
class Cause:
    """One cause of drift: change of theta when it is taken away, shape (ways, p), or why that is not known."""

    name: str
    ways: Array | None
    note: str = ""


def causes(
    runs: Sequence[RunData], trials: Sequence[TrialData], channels: Sequence[str], segments: Segments, fit: Solved,
    noise: float,
) -> tuple[Cause, ...]:  # fmt: skip
    """All causes of drift of a fit to `segments`, whose trials are `trials`; `noise` [N] as in `again`."""

    def change(other: Segments, channel: str = "", by: Array | None = None) -> Array:
        begun = fit if by is None or channel != "pressure" else fit.followed(0.0, float(np.mean(by)))
        return np.asarray(begun.again(other, noise).theta - fit.theta)

    found = []
    off = _specimen(runs, trials)
    if off is None:
        found.append(Cause(SPECIMEN, None, NO_REFERENCE))
    else:
        each = off[segments.trial]
        shrunk = replace(segments, x=segments.x / (1 + each)[:, None], v=segments.v / (1 + each)[:, None])
        pull = fit.values("F_ce", segments.pressure)
        # a stroke is (F_ce - F_L) / K: by a share of it F_ce went by that share of what is above the load
        weaker = segments.pulled(-each * np.maximum(0.0, pull - segments.force))
        found.append(Cause(SPECIMEN, np.array([change(shrunk), change(weaker)])))
    for channel in channels:
        if channel == "displacement":
            continue  # nobody knows of its zero: the specimen keeps it
        name = f"drift of the zero of {channel}"
        ends = _zero_ends(runs, trials, channel)
        if ends is None:
            found.append(Cause(name, None, NO_CHECK))
            continue
        whole, growing = (-by[segments.trial] for by in ends)
        ways = [change(_offset(segments, channel, by), channel, by) for by in (whole, growing)]
        found.append(Cause(name, np.array(ways)))
    return tuple(found)


def _specimen(runs: Sequence[RunData], trials: Sequence[TrialData]) -> Array | None:
    """Relative change of the stroke at each trial, straight lines between reference trials; shape (trials,)."""
    known = compared(runs)
    if not known:
        return None
    in_time = sorted(runs, key=lambda run: str(run.manifest.get("started_utc", "")))
    order = {run.id: place for place, run in enumerate(in_time)}
    begun = {(order.get(t.run, 0), float(t.t[0])) for t in trials} | {
        (order.get(one.trial.run, 0), float(one.trial.t[0])) for one in known
    }
    place = {key: number for number, key in enumerate(sorted(begun))}
    at: dict[int, list[float]] = {0: [0.0]}
    for one in known:
        at.setdefault(place[order.get(one.trial.run, 0), float(one.trial.t[0])], []).append(one.off)
    places = sorted(at)
    values = [float(np.mean(at[p])) for p in places]
    return np.interp([place[order.get(t.run, 0), float(t.t[0])] for t in trials], places, values)


def _zero_ends(runs: Sequence[RunData], trials: Sequence[TrialData], channel: str) -> tuple[Array, Array] | None:
    """What a zero was off by at the end of each trial's run [SI], all the time, and growing evenly; (trials,) each."""
    whole, growing = np.zeros(len(trials)), np.zeros(len(trials))
    referenced = False
    for run in runs:
        end = next(zero_drifts(run, channel), None)
        mine = np.array([trial.run == run.id for trial in trials])
        if end is None or not mine.any():
            continue
        referenced = True
        begins = np.array([float(trial.t[0]) for trial in trials])[mine]
        whole[mine] = end
        growing[mine] = end * (begins - begins.min()) / max(float(np.ptp(begins)), 1e-9)
    return (whole, growing) if referenced else None


def zero_drifts(run: RunData, channel: str) -> Iterator[float]:
    """What the zero of a channel read at each check at the end of a run, less that at the begin [SI]."""
    for event in run.events:
        if event.kind == "zero-check":
            zero = (event.data.get("channels") or {}).get(channel)
            drift = zero.get("drift") if isinstance(zero, dict) else None
            if isinstance(drift, int | float) and np.isfinite(drift):
                yield float(drift)


def _offset(segments: Segments, channel: str, by: Array) -> Segments:
    """The segments with `by` (n,) [SI] added to what a channel read."""
    if channel == "pressure":
        return replace(segments, P=segments.P + by[:, None], P_mid=segments.P_mid + by[:, None])
    return segments.pulled(np.where(segments.mass > 0, 0.0, by))


G = 9.80665
HANGING = 0.9
"""A load hangs where the moving mass weighs at least this share of it."""
LYING = 0.1
"""Before a trial the load lies on a support where the cell reads less than this share of it."""
FEWEST = 6
"""Fewest trials for a straight line over them."""
LEAST = 1e-6
"""Least scatter of a reading [N]: a simulation without noise has none."""
NORMAL = 1.96
"""Half width of a 95 % interval by its standard deviation."""


@dataclass(frozen=True)
class Weighed:
    """What the weights say of the cell; standard deviations from the scatter of the readings, widened for few."""

    drift: tuple[float, float] | None
    """Change of the zero over the campaign [N] and its standard deviation."""
    gain: tuple[float, float] | None
    """How much too much the cell reads, as a share of the weight, and its standard deviation [1]."""
    offset: tuple[float, float] | None
    """The same at no weight [N]."""


def weighed(campaign: Campaign, order: Array) -> Weighed:
    """The cell against the weights; `order` (trials,) is the place of each trial in the campaign, from -0.5 to 0.5."""
    nothing = Weighed(None, None, None)
    if not campaign.cell:
        return nothing
    loads = np.array([samples.load for samples in campaign.samples])
    ones, none = np.ones(len(loads)), np.zeros(len(loads))
    rest, held = (_means(campaign, kind) for kind in ("rest", "plateau"))
    if not np.nanmedian(np.abs([*rest, np.inf])) < LYING * np.median(loads):
        rest[:] = np.nan  # the load hangs before the trial, too: a second reading of the same
    several = np.isfinite(held).any() and np.ptp(loads[np.isfinite(held)]) > 0
    kinds = [
        (rest, np.column_stack((order, none, ones, none))),
        (held - loads, np.column_stack((order, ones, none, loads if several else none))),
    ]
    rows = [(values[np.isfinite(values)], design[np.isfinite(values)]) for values, design in kinds]
    rows = [(values / error, design / error) for values, design in rows if (error := _scatter(values, design)) > 0]
    if not rows:
        return nothing
    solved, errors = _solved(*(np.concatenate(part) for part in zip(*rows, strict=True)))
    found = [(float(a), float(s)) if s > 0 else None for a, s in zip(solved, errors, strict=True)]
    return Weighed(found[0], found[3], found[1])


def _means(campaign: Campaign, where: str) -> Array:
    """Mean reading of the cell in each trial [N], at rest before it or at its plateau; nan where there is none."""
    found = np.full(len(campaign.trials), np.nan)
    for i, (samples, trial) in enumerate(zip(campaign.samples, campaign.trials, strict=True)):
        if samples.force is None or samples.mass * G < HANGING * samples.load:
            continue
        times = [c.t for c in trial.commands if c.output == "pressure"]
        if where == "plateau":
            rows = np.zeros(len(samples.t), bool)
            rows[settled(trial)] = True
            rows &= samples.ok & (samples.x > Gate.lift)
        elif times and len(strokes(trial)):
            rows = samples.ok & (samples.t < min(times))
        else:
            continue
        if rows.sum() > 1:
            found[i] = float(np.mean(samples.force[rows]))
    return found


def _scatter(values: Array, design: Array) -> float:
    """Standard deviation of readings about a line, widened for few; 0 where they are too few."""
    columns = design[:, np.any(design != 0, axis=0)]
    if len(values) < FEWEST:
        return 0.0
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    free = len(values) - columns.shape[1]
    return max(sqrt(float(left @ left) / free), LEAST) * float(student.ppf(0.975, free)) / NORMAL


def _solved(values: Array, design: Array) -> tuple[Array, Array]:
    """Least squares of rows of error 1, and the standard deviation of each unknown; 0 for one in no row."""
    scale = np.sqrt(np.sum(design**2, axis=0))
    used = scale > 0
    columns = design[:, used] / scale[used]
    solved, errors = np.zeros(len(scale)), np.zeros(len(scale))
    inverse = np.linalg.pinv(columns.T @ columns)
    solved[used] = inverse @ (columns.T @ values) / scale[used]
    errors[used] = np.sqrt(np.diag(inverse)) / scale[used]
    return solved, errors
