"""Uncertainty of the coefficients of a pooled fit by cause.

*Repeats*: covariance of least squares with the observed noise, checked by replays and widened where trials scatter
more. *Method*: bias found by replays of the fitted muscle. *Calibration*: the fit repeated with each channel off by its
uncertainty. *Skew*: the same with the clock of each stream off. *Drift*: of the specimen from its reference trials; of
a zero from the check at the end of a run and from readings at rest before each trial. Where the stroke of a specimen
drifted, its compliance or its force may have changed; a zero may have drifted at any time. Such a cause is fitted both
ways, and the larger change counts. Each is a `Source`; together they make the parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.imported import in_time
from pmabench.analysis.shared import skew, student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import more_than_squares
from pmabench.analysis.shared.samples import LEAST_MOTION, Noise
from pmabench.analysis.shared.trials import compared
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS, Fit, noise_covariance, rms_of
from pmabench.kinds.contraction_relaxation.segments import CHANNELS, Campaign, Segments, resting
from pmabench.store.analyses.results import Parts, Source
from pmabench.store.records import Array, RunData, TrialData

if TYPE_CHECKING:
    from pmabench.kinds.contraction_relaxation.diagnosis.verdict import Diagnosis

LIES = 0.1
"""The load counts as supported where the cell reads less than this share of it."""
SPECIMEN = "drift of the specimen"
NO_REFERENCE = "no reference trial was done again"
NO_CHECK = "the record has no zero at the end"


@dataclass(frozen=True, eq=False)
class Cause:
    """A possible error and its effect on theta."""

    name: str
    """Name in the budget."""
    part: str
    """Field of `Parts` that it belongs to."""
    ways: Array | None
    """Change of theta by each variant of the error, shape (m, p); None where unknown, with the reason in `note`."""
    note: str = ""
    likely: Array | None = None
    """Probability of each variant, shape (m,); the rest to 1 is for no error. None: the worst variant counts.

    All 1 where the variants are errors that occur together and independently of each other.
    """
    seen: bool = False
    """Significant: it shifts the value in one direction, and its half width is added linearly instead of in squares."""
    kind: str = "B"
    """See `Source`."""

    def source(self, combination: Array) -> Source:
        """The line in the budget of a linear combination (p,) of the coefficients."""
        half = None
        if self.ways is not None:
            changes = self.ways @ combination
            worst = float(np.max(np.abs(changes), initial=0.0))
            half = worst if self.likely is None else sqrt(float(changes**2 @ self.likely))
        return Source(self.name, self.part, self.kind, half, self.note)


AT_REST = "zero of {}, by what it reads at rest"
READS = {
    "pressure": "vented, the gauge reads {}: its zero, or a regulator that does not vent. The intervals hold both. "
    "Vent the muscle and take the zero of the gauge",
    "displacement": "with the load on its support, the displacement reads {}: its zero, or the muscle has its "
    "nominal length elsewhere. The intervals hold both. Take the zero of the displacement there",
}
SEEN = 4.0
"""Standard errors from which on a reading at rest is significant."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Reading of a channel before the first command of each trial, beyond noise and calibration."""

    off: Array
    """Reading minus that of the first trial, and minus the median [SI], shape (2, trials); 0 where nothing was
    recorded.
    """
    level: float
    """Reading nearest to 0 among trials that begin vented [SI]; 0 where noise or calibration may explain it. For a
    displacement only of trials where the cell shows that the load is supported.
    """
    known: float
    """Uncertainty of the zero from the calibration [SI]."""

    @classmethod
    def of(cls, campaign: Campaign, channel: str) -> Rest:
        """From the rests of a channel in the campaign."""
        known = Scales.of(campaign.runs).offsets.get(channel, 0.0)
        mean, variance = np.full((2, len(campaign.trials)), np.nan)
        vented, off = np.zeros(len(mean), bool), np.zeros((2, len(mean)))
        for i, (trial, one) in enumerate(zip(campaign.trials, campaign.samples, strict=True)):
            rest = resting(one, trial)
            if rest.sum() < 2:
                continue
            values = one.channels[channel][rest]
            mean[i], variance[i] = float(np.mean(values)), float(np.var(values, ddof=1)) / len(values)
            first = min((c for c in trial.commands if c.output == "pressure"), key=lambda c: c.t)
            lies = one.force is not None and abs(one.force[rest].mean()) <= LIES * one.load
            vented[i] = first.before == 0 and (lies or channel != "displacement")
        read = np.flatnonzero(np.isfinite(mean))
        if len(read) > 1:
            seen = float(np.var(mean[read], ddof=1))
            share = np.sqrt(max(0.0, 1.0 - float(np.mean(variance[read])) / max(seen, 1e-300)))
            begun = read[np.argmin([float(campaign.samples[i].t[0]) for i in read.tolist()])]
            off = share * np.nan_to_num(mean - np.array([[mean[begun]], [np.median(mean[read])]]))
        level = 0.0
        if vented.sum() > 1 and not mean[vented].min() <= 0 <= mean[vented].max():
            level = float(min(mean[vented], key=abs))
        least = max(known, SEEN * sqrt(np.max(variance[vented], initial=0.0)), LEAST_MOTION.get(channel, 0.0))
        return cls(off - np.clip(off, -known, known), level if abs(level) > least else 0.0, known)


def causes_of(
    campaign: Campaign, segments: Segments, fit: Fit, noise: float, rests: Mapping[str, Rest]
) -> Iterator[Cause]:
    """Drifts and zero errors that affect a fit to `segments`; `noise` [N] as in `Fit.again`, `rests`: channel -> its
    readings at rest.
    """

    def zeros(channel: str, each: Iterable[Array | float]) -> Array:
        """Change of theta by each zero error [SI], a number or (n,)."""
        ways = [_off(segments, fit, channel, 0.0, by, noise) - fit.theta for by in each]
        return np.array(ways).reshape(-1, len(fit.theta))

    off = _specimen(campaign.runs, campaign.trials)
    if off is None:
        yield Cause(SPECIMEN, "drift", None, NO_REFERENCE)
    else:
        each = off[segments.trial]
        shrunk = replace(segments, x=segments.x / (1 + each)[:, None], v=segments.v / (1 + each)[:, None])
        pull = fit.values("F_ce", segments.pressure)
        # the stroke is (F_ce - F_L) / K: a relative change of it equals a change of F_ce by that share of F_ce - F_L
        weaker = segments.pulled(-each * np.maximum(0.0, pull - segments.force))
        changes = [fit.again(other, noise).theta - fit.theta for other in (shrunk, weaker)]
        yield Cause(SPECIMEN, "drift", np.array(changes))
    for channel, rest in rests.items():
        ways = zeros(channel, (by for by in -rest.off[:, segments.trial] if by.any()))
        yield Cause(f"zero of {channel} from trial to trial", "drift", ways)
    for channel in campaign.channels:
        if channel != "displacement":  # its zero belongs to the specimen: no check measures it
            ends = _zero_ends(campaign.runs, campaign.trials, channel)
            ways_of = None if ends is None else zeros(channel, (-by[segments.trial] for by in ends))
            yield Cause(f"drift of the zero of {channel}", "drift", ways_of, NO_CHECK if ends is None else "")
    for channel, rest in rests.items():
        if rest.level:
            change = zeros(channel, [float(np.sign(rest.level)) * rest.known - rest.level])
            said = READS[channel].format(show(rest.level, "pressure" if channel == "pressure" else "length", 2))
            yield Cause(AT_REST.format(channel), "calibration", change, said, seen=True)


def _specimen(runs: Sequence[RunData], trials: Sequence[TrialData]) -> Array | None:
    """Relative change of the stroke at each trial, interpolated between reference trials; shape (trials,)."""
    known = compared(runs)
    if not known:
        return None
    order = {run.id: place for place, run in enumerate(in_time(runs))}

    def begun(trial: TrialData) -> tuple[int, float]:
        return order.get(trial.run, 0), float(trial.t[0])

    place = {key: number for number, key in enumerate(sorted({*map(begun, trials), *(begun(o.trial) for o in known)}))}
    at: dict[int, list[float]] = {0: [0.0]}
    for one in known:
        at.setdefault(place[begun(one.trial)], []).append(one.off)
    places = sorted(at)
    return np.interp([place[begun(t)] for t in trials], places, [float(np.mean(at[p])) for p in places])


def _zero_ends(runs: Sequence[RunData], trials: Sequence[TrialData], channel: str) -> tuple[Array, Array] | None:
    """Two courses of a zero error measured at the end of each trial's run [SI]: constant, and growing evenly; (trials,)
    each. None without a check.
    """
    ends = {run.id: end for run in runs if (end := next(zero_drifts(run, channel), None)) is not None}
    if not any(trial.run in ends for trial in trials):
        return None
    whole = np.array([ends.get(trial.run, 0.0) for trial in trials])
    return whole, whole * 0.5 * (1 + skew.courses(trials)[1])


def zero_drifts(run: RunData, channel: str) -> Iterator[float]:
    """Change of a channel's zero in each check at the end of a run, relative to its start [SI]."""
    for event in run.events:
        if event.kind == "zero-check":
            zero = (event.data.get("channels") or {}).get(channel)
            drift = zero.get("drift") if isinstance(zero, dict) else None
            if isinstance(drift, int | float) and np.isfinite(drift):
                yield float(drift)


NORMAL = 1.96
"""Half width of a 95 % interval in standard deviations."""
SCATTER = "noise, and scatter between trials"
NO_UNCERTAINTY = "the record has no uncertainty"
FEW = 10
"""With fewer repetitions in all, scatter is taken between all trials instead of within cells."""


CORRECTED = "correction"


@dataclass(frozen=True, eq=False)
class Correction:
    """Uncertainty of a fit because its samples were corrected."""

    changes: Array
    """Change of theta by the part of each step of the correction that may be wrong; shape (m, p)."""
    spreads: tuple[Array, ...]
    """Jackknife covariances of theta over loads and over trials, with the correction sized anew; (p, p) each."""
    others: Array
    """Change of theta by each other possible explanation, shape (m, p)."""
    factor: float
    """Factor on all half widths of the budget."""

    def variance(self, combination: Array) -> float:
        """Largest variance of a linear combination (p,) of the coefficients by `spreads`."""
        return max((float(combination @ spread @ combination) for spread in self.spreads), default=0.0)

    def half(self, combination: Array) -> float:
        """Half width by the possibly wrong share of the correction, and by other explanations."""
        apart = float(np.max(np.abs(self.others @ combination), initial=0.0))
        return hypot(float(np.linalg.norm(self.changes @ combination)), apart)


@dataclass(frozen=True, eq=False)
class Trust:
    """Uncertainty of `theta` by source, half widths of 95 % intervals, and the bias to subtract; shape (p,) each."""

    bias: Array
    covariance: Array
    """For the repeats part, shape (p, p)."""
    steps: Mapping[str, Array]
    """Contribution of the steps of a channel's values to `covariance`, shape (p, p) each."""
    causes: tuple[Cause, ...]
    """Sources of all other parts except skew."""
    skews: Array
    """Change of theta by the clock of each stream at its bound, shape (clocks, courses, p); (0, 0, p) for one clock."""
    excess: Mapping[str, float]
    """Symbol -> variance between trials, relative to that of the noise."""
    within: bool
    """True if that scatter is within cells, between repeats; False if between all trials."""
    correction: Correction | None = None

    def parts(self, combination: Array, extra_method: float = 0.0) -> tuple[Parts, float]:
        """Interval parts and bias of a linear combination (p,) of the coefficients."""
        return self.budget(combination, extra_method)[:2]

    def budget(self, combination: Array, extra_method: float = 0.0) -> tuple[Parts, float, tuple[Source, ...]]:
        """The same, and all sources behind them, largest first."""
        variance = max(0.0, float(combination @ self.covariance @ combination))
        if self.correction is not None:
            variance = max(variance, self.correction.variance(combination))
        steps = {name: max(0.0, float(combination @ part @ combination)) for name, part in self.steps.items()}
        shrink = min(1.0, variance / max(1e-300, sum(steps.values())))
        found = [
            Source(SCATTER, "repeats", "A", NORMAL * sqrt(max(0.0, variance - shrink * sum(steps.values())))),
            *(Source(f"steps of {name}", "repeats", "B", NORMAL * sqrt(shrink * v)) for name, v in steps.items()),
            *([Source("steps of the replays", "method", "B", extra_method)] if extra_method else ()),
            *(one.source(combination) for one in self.causes if not one.seen),
            Source("regulator", "method", "B", 0.0, "the fit is driven by the pressure that was measured"),
        ]  # fmt: skip
        if self.correction is not None:
            found.append(Source(CORRECTED, "method", "B", self.correction.half(combination)))
        if len(self.skews):
            apart = float(np.sum(np.max(np.abs(self.skews @ combination), axis=1, initial=0.0)))
            found.append(Source("time between the streams", "skew", "B", apart))
        seen = [one.source(combination) for one in self.causes if one.seen]
        more = more_than_squares([one.half or 0.0 for one in seen], parts_of(found).combined or 0.0)
        found += [replace(one, half=more * (one.half or 0.0)) for one in seen]
        if self.correction is not None:
            found = [replace(s, half=None if s.half is None else self.correction.factor * s.half) for s in found]
        found.sort(key=lambda source: -1.0 if source.half is None else source.half, reverse=True)
        return parts_of(found), float(combination @ self.bias), tuple(found)


def parts_of(sources: Sequence[Source]) -> Parts:
    """The interval parts as root sums of squares of the sources."""

    def of(part: str) -> float | None:
        halves = [s.half for s in sources if s.part == part and s.half is not None]
        return sqrt(sum(half * half for half in halves)) if halves else None

    return Parts(of("repeats"), of("method"), of("calibration"), of("skew") or 0.0, of("drift") or 0.0)


@dataclass(frozen=True, eq=False)
class Pooled:
    """A pooled fit, its segments and its uncertainty."""

    campaign: Campaign
    """Corrected for faults of the bench that were found."""
    segments: Segments
    """Of `campaign`, minus the forces of the muscle beyond the straight form."""
    fit: Fit
    noise: Array
    """Standard deviation of each segment by the noise of the channels [N]; shape (n,)."""
    trust: Trust
    diagnosis: Diagnosis
    """Whether the data have the form of the fit, and what was corrected."""

    @property
    def expected(self) -> float:
        """Root mean square of the residual that the noise of the channels explains [N]."""
        return rms_of(self.noise)


def assess(
    campaign: Campaign, segments: Segments, fit: Fit, noise: Array, replays: Sequence[Array], skews: Array,
    causes: Iterable[Cause],
) -> Trust:  # fmt: skip
    """All parts for a fit to segments of a campaign.

    Parameters
    ----------
    noise
        Standard deviation of each segment by the noise of the channels [N], shape (n,).
    replays
        Theta of fits to replays of `fit`.
    skews
        As in `Trust`.
    causes
        See `causes_of`.
    """
    off = np.array(replays).reshape(-1, len(fit.theta)) - fit.theta
    spread = off.std(axis=0, ddof=1) if len(off) > 1 else np.zeros(len(fit.theta))
    bias = off.mean(axis=0) if len(off) else np.zeros(len(fit.theta))
    unsure = 2.0 * spread / np.sqrt(max(1, len(replays)))
    expected = rms_of(noise)
    more = max(1.0, fit.rms / expected)
    after = noise_covariance(segments, fit, campaign.noise)[1]
    covariance = more**2 * _covariance(fit, noise) + fit.shared(after)
    analytic = np.diag(covariance)
    seen = analytic
    if len(replays) > 1:
        seen = 0.5 * (analytic + (more * spread) ** 2)
        if campaign.pressure_step:  # steps lie at the same values in all trials: only replays show their effect
            seen = np.maximum(seen, (more * spread) ** 2)
    between, freedom, within = _between(segments, fit, campaign.cells)
    ratio = between / np.maximum(seen, 1e-300)
    excess = {symbol: _pooled(fit, symbol, ratio) for symbol in (*SYMBOLS, "F_c")}
    pooled = np.ones(len(fit.theta))
    for symbol, of_symbol in excess.items():
        pooled[fit.columns(symbol)] = of_symbol
    widen = np.maximum(1.0, 0.5 * (pooled + ratio))
    stretch = student.ppf(0.975, freedom) / NORMAL
    scale = np.sqrt(seen / analytic * (1.0 + stretch**2 * (widen - 1.0)))
    return Trust(
        bias=bias,
        covariance=covariance * np.outer(scale, scale),
        steps={n: fit.scatter(segments, Noise(**{n: size})) for n, size in vars(campaign.steps).items() if size > 0},
        causes=(
            Cause("bias of the fit, taken off", "method", bias[None]),
            Cause("scatter of the replays", "method", np.diag(unsure), "", np.ones(len(unsure)), kind="A"),
            Cause("straight lines between pressures", "method", fit.bends(segments, expected)[None], seen=True),
            *_calibration(segments, fit, expected, Scales.of(campaign.runs)),
            *_zero_by_session(campaign, segments, fit, expected),
            *causes,
        ),
        skews=skews,
        excess=excess,
        within=within,
    )


def _covariance(fit: Fit, noise: Array) -> Array:
    """Covariance of theta for independent segments of unequal `noise` (n,) [N]; the prior counts as rows of its rms."""
    even = rms_of(noise) ** 2
    uneven = (fit.design * noise[:, None] ** 2).T @ fit.design - even * (fit.design.T @ fit.design)
    return np.asarray(even * fit.inverse + fit.inverse @ uneven @ fit.inverse)


def _between(segments: Segments, fit: Fit, cells: NDArray[np.intp]) -> tuple[Array, Array, bool]:
    """Variance of theta from the scatter between trials, its degrees of freedom (p,), and whether it is within cells.

    The limit of many draws of a bootstrap over trials (resampling their normal equations): variance of inverse @ sum of
    the trials' scores A'r. Within a cell, scores count from their mean, with n/(n - 1). Degrees of freedom by
    Satterthwaite, from the share of each trial in a coefficient.
    """
    trials, rows = np.unique(segments.trial, return_inverse=True)
    scores, bearing = (np.zeros((len(trials), len(fit.theta))) for _ in range(2))
    np.add.at(scores, rows, fit.design * fit.residual[:, None])
    np.add.at(bearing, rows, (fit.design @ fit.inverse) ** 2)
    effective = bearing.sum(axis=0) ** 2 / np.maximum(1e-300, (bearing**2).sum(axis=0))
    own = cells[trials]
    _, cell, count = np.unique(own, return_inverse=True, return_counts=True)
    total, freedom = len(trials), len(trials) - len(count)
    within = freedom >= FEW
    if within:
        means = np.zeros((len(count), scores.shape[1]))
        np.add.at(means, cell, scores)
        n = count[cell]
        repeated = n > 1
        off = (scores - (means / count[:, None])[cell])[repeated] * np.sqrt(n[repeated] / (n[repeated] - 1))[:, None]
        off *= np.sqrt(total / int(repeated.sum()))
    else:
        freedom = max(1, total - 1)
        off = scores * np.sqrt(total / freedom)
    return np.sum((off @ fit.inverse) ** 2, axis=0), np.maximum(1.0, effective * freedom / total), within


def _pooled(fit: Fit, symbol: str, ratio: Array) -> float:
    """Mean of `ratio` over those coefficients of a symbol that are determined by samples."""
    columns = fit.columns(symbol)
    if symbol == "F_c":
        return float(ratio[columns][0]) if fit.friction else 1.0
    weight = np.sum(fit.design[:, columns] ** 2, axis=0)
    solid = weight > 0.05 * weight.max()
    return float(np.mean(ratio[columns][solid])) if solid.any() else 1.0


def _calibration(segments: Segments, fit: Fit, expected: float, scales: Scales) -> Iterator[Cause]:
    """Effect of each channel's offset and gain at its expanded uncertainty: half the difference between both signs."""
    for channel in CHANNELS:
        for name, known in (("offset", scales.offsets), ("gain", scales.gains)):
            if by := known.get(channel, 0.0):
                gain, offset = (by, 0.0) if name == "gain" else (0.0, by)
                up, down = (_off(segments, fit, channel, way * gain, way * offset, expected) for way in (1.0, -1.0))
                yield Cause(f"calibration of {channel}, {name}", "calibration", 0.5 * (up - down)[None])
    for channel in CHANNELS if not (segments.mass > 0).all() else CHANNELS[:2]:
        if not scales.offsets.get(channel) and not scales.gains.get(channel):
            yield Cause(f"calibration of {channel}", "calibration", None, NO_UNCERTAINTY)


def _zero_by_session(campaign: Campaign, segments: Segments, fit: Fit, expected: float) -> Iterator[Cause]:
    """Effect of a zero that is another one in each session, anywhere within its uncertainty: it does not cancel where
    a load or a pressure was tested in one session only.
    """
    day = campaign.sessions[segments.trial]
    for channel, by in Scales.of(campaign.runs).offsets.items() if day.max(initial=0) > 0 else ():
        if channel in CHANNELS and by:
            ways = [_off(segments, fit, channel, 0.0, by * (day == one), expected) for one in np.unique(day)]
            own = np.array(ways) - fit.theta
            yield Cause(f"zero of {channel} from session to session", "calibration", own, likely=np.ones(len(own)))


def _off(segments: Segments, fit: Fit, channel: str, gain: float, offset: float | Array, expected: float) -> Array:
    """Theta of the fit where a channel reads (1 + gain) times as much, plus `offset` [SI], one or (n,)."""
    begun = fit.followed(gain, float(np.mean(offset))) if channel == "pressure" else fit
    shifted = segments.shifted(channel, gain, offset)
    return begun.again(shifted, expected, fit.shifted(channel, gain, offset)).theta
