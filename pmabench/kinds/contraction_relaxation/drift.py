"""What drifted during a campaign and its effect on the fit: the specimen and the zeros.

The specimen by its reference trials, a zero by the check at the end of a run, and by what is read at rest before each
trial. Nobody knows what drifted in a specimen whose stroke did: its compliance or its force; nor when a zero went. Each
cause is fitted both ways, the larger counts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmabench.analysis.imported import in_time
from pmabench.analysis.shared.samples import Samples
from pmabench.analysis.shared.trials import compared
from pmabench.kinds.contraction_relaxation.pooled import Solved
from pmabench.kinds.contraction_relaxation.segments import Segments
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


def at_rest(trials: Sequence[TrialData], samples: Sequence[Samples], channel: str, known: float) -> Array:
    """What a channel reads before the first command of each trial, less the first, and less the median [SI], as far as
    noise and a zero that its calibration leaves open, `known` [SI], do not make it; shape (2, trials), 0 where nothing
    was recorded then.
    """
    found, noise = np.full(len(trials), np.nan), np.full(len(trials), np.nan)
    for i, (trial, one) in enumerate(zip(trials, samples, strict=True)):
        times = [c.t for c in trial.commands if c.output == "pressure"]
        rest = one.ok & (one.t < min(times, default=-np.inf))
        if rest.sum() > 1:
            values = (one.P if channel == "pressure" else one.x)[rest]
            found[i], noise[i] = float(np.mean(values)), float(np.var(values, ddof=1)) / len(values)
    read = np.flatnonzero(np.isfinite(found))
    if len(read) < 2:
        return np.zeros((2, len(trials)))
    seen = float(np.var(found[read], ddof=1))
    share = np.sqrt(max(0.0, 1.0 - float(np.mean(noise[read])) / max(seen, 1e-300)))
    first = read[np.argmin([float(samples[i].t[0]) for i in read.tolist()])]
    off = share * np.nan_to_num(found - np.array([[found[first]], [np.median(found[read])]]))
    return np.asarray(off - np.clip(off, -known, known))


def causes(
    runs: Sequence[RunData], trials: Sequence[TrialData], channels: Sequence[str], segments: Segments, fit: Solved,
    noise: float, rests: Mapping[str, Array],
) -> tuple[Cause, ...]:  # fmt: skip
    """All causes of drift of a fit to `segments`, whose trials are `trials`; `noise` [N] as in `again`, and `rests`
    what channels read `at_rest`.
    """

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
    for channel, rest in rests.items():
        ways = [change(_offset(segments, channel, by), channel, by) for by in -rest[:, segments.trial] if by.any()]
        found.append(Cause(f"zero of {channel} from trial to trial", np.array(ways).reshape(-1, len(fit.theta))))
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
    order = {run.id: place for place, run in enumerate(in_time(runs))}
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
    if channel == "displacement":
        return replace(segments, x=segments.x + by[:, None])
    return segments.pulled(np.where(segments.mass > 0, 0.0, by))
