"""Why a fit fails: competing explanations, each corrected and tested, in at most four rounds.

A `State` is a campaign with some explanations corrected: their sizes, the fit, and the test of the rest. Every
explanation is sized by least squares together with the coefficients; times of streams are searched numerically.

In each round all remaining explanations are tried, and the one that predicts left-out trials best is kept. At the end
each of those kept is removed again and the others are tried in its place: where one does nearly as well, the data do
not decide between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pmabench.kinds.contraction_relaxation.diagnosis import columns
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import (
    MOST_LATE,
    TIMES,
    Explanation,
    forces_of,
    in_samples,
    muscle_columns,
    plausible,
)
from pmabench.kinds.contraction_relaxation.diagnosis.held_out import Test
from pmabench.kinds.contraction_relaxation.pooled import Fit, design_of, fit, rms_of, solve
from pmabench.kinds.contraction_relaxation.segments import Campaign, Cut, Kept, Segments
from pmabench.store.records import Array

MOST_CUTS = 3
"""Number of corrected campaigns that are cached: the attempts of a round share most of them."""
ALONE = 2.0
"""An explanation is the only one if the best of another kind leaves more than this many times its excess ..."""
LEAST_EXCESS = 0.15
"""... which counts as at least this."""
PASSES = 3
"""Iterations of the sizes, each with samples corrected by the one before."""
PLACES = 2
"""Number of places of a slip that are tried completely: the best to first order."""
MOST_COMPARED = 3
"""Most explanations of a round that are compared with knots of their own."""
FROM_BEGIN = (0.5, 1.0)
"""Start of the search for both sizes of a clock error, relative to the second one: a clock that is right at the start
of a run, as most are.
"""
STEPS = (5e-3, 1.5e-3)
"""Steps of the search for a time [s]; only the last one where a size is known already."""
WORTH = 0.9
"""An explanation that to first order leaves more than this share of the excess is not tried completely."""
ALL_OF_MUSCLE = (
    Explanation("bend", "as K"),
    Explanation("hysteresis"),
    Explanation("creep", "by time"),
)
FINEST = (Explanation("bend", "steep"), *(Explanation(kind, variant) for kind, variant in columns.FINER.items()))
"""All properties of the muscle in their finest forms, for a muscle that coarser ones do not describe."""


@dataclass(frozen=True, eq=False)
class State:
    """The campaign with some explanations corrected, and the fit and test of the rest."""

    explanations: tuple[Explanation, ...]
    test: Test
    straight: Fit
    """Fit whose K converts properties of the muscle to forces."""
    own_knots: bool = False
    """Whether its knots were placed for its own residual."""

    @property
    def excess(self) -> float:
        """See `Test.excess`."""
        return self.test.excess

    @property
    def last(self) -> Explanation:
        """The explanation that was added last."""
        return self.explanations[-1]


@dataclass(frozen=True, eq=False)
class Search:
    """A recorded campaign, and how it is cut into segments and fitted."""

    campaign: Campaign
    cut: Cut
    knots: Array
    """First knots of a fit [Pa]."""
    drifts: bool = True
    """Whether the cell may have drifted; False where weights show the drift, which is then corrected already."""
    cuts: dict[tuple[Explanation, ...], tuple[Campaign, Segments]] = field(default_factory=dict)
    """Cache: faults of the bench -> campaign and segments corrected for them."""
    kept: Kept = field(default_factory=Kept)

    def fitted(self, explanations: tuple[Explanation, ...], begin: State | None = None) -> State:
        """State with these explanations, starting from sizes in `begin`, with knots where the residual needs them."""
        segments = self._corrected(explanations)[1] if begin is None else begin.test.segments
        solved, noise = fit(segments, self.knots, self.campaign.noise)
        if begin is None:
            campaign = in_samples(self.campaign, explanations)
            return State(explanations, Test.of(campaign, segments, solved, rms_of(noise)), solved, True)
        return replace(self.state(explanations, solved, rms_of(noise)), own_knots=True)

    @property
    def uncorrected(self) -> Segments:
        """Segments of the campaign as it was recorded."""
        return self._corrected(())[1]

    @cached_property
    def followed(self) -> columns.Followed:
        """Friction elements and lags driven by the recorded contraction."""
        return columns.Followed.of(self.campaign)

    def state(
        self, explanations: tuple[Explanation, ...], solved: Fit, expected: float, *, timed: bool = True
    ) -> State:
        """State with the explanations sized together with the coefficients at the knots of `solved`, and corrected.

        Times of streams are searched numerically, since the noise of a derivative would make a least-squares size too
        small; if not `timed`, they keep their sizes.
        """
        straight = solved
        linear = [i for i, one in enumerate(explanations) if one.kind not in TIMES]
        streams = [i for i, one in enumerate(explanations) if one.kind in TIMES]
        for _ in range(PASSES if linear else min(1, len(streams))):
            for i in streams if timed else []:
                explanations = self._timed(explanations, i, straight, expected)
            if linear:
                campaign, segments = self._corrected(explanations)
                raw = self.again(solved, segments, expected)
                forces = [self.columns(explanations[i], campaign, segments, straight, explanations) for i in linear]
                explanations = _sized(explanations, linear, sizes_of(raw, np.hstack(forces)))
                straight = self._rest(explanations, straight, solved, expected)[1]
        left, final = self._rest(explanations, straight, solved, expected)
        return State(explanations, Test.of(self._corrected(explanations)[0], left, final, expected), straight)

    def _rest(
        self, explanations: tuple[Explanation, ...], straight: Fit, like: Fit, noise: float
    ) -> tuple[Segments, Fit]:
        """The rest after all corrections, and the fit to it at the knots of `like`."""
        segments = self._corrected(explanations)[1]
        off = forces_of(self.followed, segments, straight, explanations)
        return segments.pulled(-off), self.again(like, segments, noise).pulled(-off)

    def again(self, like: Fit, segments: Segments, noise: float) -> Fit:
        """`Fit.again`; the last one, and the last design, are cached."""
        moves = like.knots, segments.way, segments.P, segments.x, segments.v
        design = self.kept.of("design", moves, lambda: design_of(segments, like.knots))
        known = (*moves, segments.force, noise)
        fit: Fit = self.kept.of("fit", known, lambda: solve(segments, like.knots, noise, design))
        return replace(fit, halves=like.halves, added=like.added)

    def _corrected(self, explanations: Sequence[Explanation]) -> tuple[Campaign, Segments]:
        """The campaign corrected for faults of the bench, and its segments; the last few are cached."""
        faults = tuple(one for one in explanations if not one.of_muscle)
        found = self.cuts.pop(faults, None)
        if found is None:
            before = self.kept.of("before", faults[:-1], lambda: in_samples(self.campaign, faults[:-1]))
            campaign = in_samples(before, faults[-1:])
            found = campaign, self.cut(campaign.samples)
            while len(self.cuts) >= MOST_CUTS:
                del self.cuts[next(iter(self.cuts))]
        self.cuts[faults] = found
        return found

    def columns(
        self, one: Explanation, campaign: Campaign, segments: Segments, fit: Fit, others: Sequence[Explanation] = ()
    ) -> Array:
        """First-order change of F_L by each size of an explanation [N per SI], shape (n, sizes)."""
        if one.kind == "drift":
            return columns.drift(campaign, segments)[:, None]
        if one.kind == "slip":
            return columns.slip(campaign, segments, fit, int(one.which))[:, None]
        if one.kind in TIMES:
            late = columns.late(segments, fit, campaign.cell)[one.which][0][:, None]
            growing = late * columns.clock(campaign)[segments.trial, None]
            return np.hstack((late, growing)) if one.kind == "clock" else late
        return muscle_columns(one, self.followed, segments, fit, others)

    def _timed(
        self, explanations: tuple[Explanation, ...], place: int, fit: Fit, noise: float
    ) -> tuple[Explanation, ...]:
        """The explanations with the time of one of them at the least sum of squares of the residual."""
        one = explanations[place]
        known: dict[float, float] = {}

        def with_size(size: float) -> tuple[Explanation, ...]:
            return _with(explanations, place, tuple(size * share for share in FROM_BEGIN[-len(one.sizes) :]))

        def squares(size: float) -> float:
            size = min(max(size, -MOST_LATE), MOST_LATE)
            if size not in known:
                known[size] = float(np.mean(self.left(with_size(size), fit, noise)[1] ** 2))
            return known[size]

        if one.kind == "clock" and any(one.sizes):
            return self._clocked(explanations, place, fit, noise)
        best = one.sizes[-1]
        for step in STEPS if best == 0 else STEPS[-1:]:
            way = step if squares(best + step) < squares(best - step) else -step
            while squares(best + way) < squares(best) and abs(best + way) < MOST_LATE:
                best += way
            before, now, after = (squares(best + by) for by in (-step, 0.0, step))
            curved = before + after - 2 * now
            squares(best + 0.5 * step * (before - after) / curved if curved > 0 else best)
            best = min(known, key=squares)
            if squares(best) > WORTH * squares(0.0):
                break
        found = with_size(best)
        return self._clocked(found, place, fit, noise) if one.kind == "clock" else found

    def _clocked(
        self, explanations: tuple[Explanation, ...], place: int, fit: Fit, noise: float
    ) -> tuple[Explanation, ...]:
        """The same for both sizes of a clock together, from their present values (Gauss-Newton)."""
        for _ in range(PASSES):
            campaign, segments = self._corrected(explanations)
            raw, one = self.again(fit, segments, noise), explanations[place]
            sizes = one.sizes + sizes_of(raw, self.columns(one, campaign, segments, raw))
            if not (np.abs(sizes) < 2 * MOST_LATE).all():  # no clock: another thing is wrong
                break
            explanations = _with(explanations, place, tuple(sizes.tolist()))
        return explanations

    def left(self, explanations: tuple[Explanation, ...], fit: Fit, noise: float) -> tuple[Segments, Array]:
        """Corrected segments and the residual of the fit to them; properties of the muscle are sized anew."""
        campaign, segments = self._corrected(explanations)
        raw = self.again(fit, segments, noise)
        mine = [self.columns(one, campaign, segments, fit, explanations) for one in explanations if one.of_muscle]
        if not mine:
            return segments, raw.residual
        forces = np.hstack(mine)
        off = forces @ sizes_of(raw, forces)
        return segments.pulled(-off), raw.pulled(-off).residual

    def others(self, now: State, but: str = "") -> list[State]:
        """`now` with one more explanation each: the best of every cause that it lacks, except `but`; best first."""
        known = {one.family for one in now.explanations}
        tried = [one for one in self._possible(now) if one.family not in known and one.cause != but]
        test = now.test
        groups = [self.columns(one, test.campaign, test.segments, test.fit, now.explanations) for one in tried]
        tried = [replace(one, sizes=(0.0,) * each.shape[1]) for one, each in zip(tried, groups, strict=True)]
        first = test.with_columns(groups) if groups else []
        best: dict[str, State] = {}
        for one in _promising(tried, first, now):
            if one.kind == "lag":
                late = best.get(one.cause)
                if late is None or late.excess > WORTH * now.excess:
                    continue
                one = replace(one, sizes=late.last.sizes)
            state = self._added(now, one)
            if not plausible(state.last):
                continue
            excess = (ALONE if one.kind == "clock" else 1.0) * state.excess  # a clock has a size more than a delay
            if one.cause not in best or excess < best[one.cause].excess:
                best[one.cause] = state
        return sorted(best.values(), key=lambda state: state.test.ratio)

    def compared(self, tried: Sequence[State]) -> list[State]:
        """The same, best first. If several are near the best, these are fitted again with knots for their own residuals
        first, since their knots were placed for another one.
        """
        limit = ALONE * max(tried[0].excess, LEAST_EXCESS) if tried else 0.0
        near = [state for state in tried[:MOST_COMPARED] if state.excess < limit]
        if len(near) < 2:
            return list(tried)
        again = [self.fitted(state.explanations, state) for state in near]
        return sorted((*again, *tried[len(near) :]), key=lambda state: state.test.ratio)

    def _added(self, now: State, one: Explanation) -> State:
        explanations, test = (*now.explanations, one), now.test
        if one.kind in TIMES:
            explanations = self._timed(explanations, len(now.explanations), test.fit, test.expected)
        return self.state(explanations, test.fit, test.expected, timed=False)

    def _possible(self, now: State) -> Iterator[Explanation]:
        cell = self.campaign.cell
        if cell and self.drifts:
            yield Explanation("drift")
        for place in columns.slip_places(now.test.campaign, now.test.segments):
            yield Explanation("slip", str(place))
        for channel in ("pressure", "displacement", *(("force",) if cell else ())):
            yield from (Explanation(kind, channel) for kind in TIMES)
        for kind, variants in columns.OF_MUSCLE.items():
            yield from (Explanation(kind, one) for one in variants if one != columns.FINER.get(kind))

    def other_kinds(self, now: State) -> Iterator[State]:
        """`now` with a filter in place of a delay, or a delay in place of a filter, of each stream that has one."""
        for one in now.explanations:
            if one.kind in ("late", "lag"):
                kind = "lag" if one.kind == "late" else "late"
                rest = tuple(other for other in now.explanations if other is not one)
                yield self._added(replace(now, explanations=rest), replace(one, kind=kind))

    def finer(self, now: State) -> State | None:
        """`now` with creep that may depend on the load, or hysteresis that may differ by direction, in place of the
        simpler form; None where there is none, or it is not plausible.
        """
        found = []
        for one in now.explanations:
            variant = columns.FINER.get(one.kind, one.which)
            if one.which == variant:
                continue
            rest = tuple(other for other in now.explanations if other is not one)
            state = self.with_more(now, rest, [Explanation(one.kind, variant)])
            if plausible(state.last):
                found.append(state)
        return min(found, key=lambda state: state.excess, default=None)

    def with_more(self, now: State, kept: tuple[Explanation, ...], more: Sequence[Explanation]) -> State:
        """`now` with only the explanations `kept`, and more properties of the muscle."""
        test = now.test
        sizes = [self.columns(one, test.campaign, test.segments, test.fit).shape[1] for one in more]
        sized = (replace(one, sizes=(0.0,) * many) for one, many in zip(more, sizes, strict=True))
        return self.state((*kept, *sized), test.fit, test.expected, timed=False)


def _promising(tried: Sequence[Explanation], ratios: Sequence[float], now: State) -> list[Explanation]:
    """Explanations worth trying completely: those that explain something to first order; delays and filters always."""
    slips = sorted((r, i) for i, (one, r) in enumerate(zip(tried, ratios, strict=True)) if one.kind == "slip")
    best_slips = {i for _, i in slips[:PLACES]}
    return [
        one
        for i, (one, ratio) in enumerate(zip(tried, ratios, strict=True))
        if one.kind in ("late", "lag")
        or (ratio**2 - 1 < WORTH * now.excess and (one.kind != "slip" or i in best_slips))
    ]


def sizes_of(solved: Fit, forces: Array) -> Array:
    """Sizes (k,) of forces (n, k) by least squares together with the coefficients of a fit without them."""
    scale = np.maximum(np.sqrt(np.mean(forces**2, axis=0)), 1e-300)
    unit = forces / scale
    left = unit.T @ unit - (unit.T @ solved.design) @ solved.change(unit)
    return np.asarray(np.linalg.lstsq(left, unit.T @ solved.residual, rcond=1e-9)[0] / scale)


def _with(explanations: Sequence[Explanation], place: int, sizes: tuple[float, ...]) -> tuple[Explanation, ...]:
    """The explanations with other sizes of one of them."""
    return (*explanations[:place], replace(explanations[place], sizes=sizes), *explanations[place + 1 :])


def _sized(explanations: tuple[Explanation, ...], places: Sequence[int], sizes: Array) -> tuple[Explanation, ...]:
    """The explanations with new sizes: replaced for the muscle, added to the existing correction for the bench."""
    begin = 0
    for place in places:
        one = explanations[place]
        mine = sizes[begin : begin + len(one.sizes)]
        begin += len(one.sizes)
        explanations = _with(explanations, place, tuple((mine if one.of_muscle else one.sizes[0] + mine).tolist()))
    return explanations


MOST_ROUNDS = 4
EXPLAINS = 0.7
"""Share of the excess that an explanation must remove."""
FURTHER = 0.25
"""Share of the remaining excess that a property of the muscle must remove in a later round."""
STILL_APART = 1.25
"""Ratio to the limit of doubt up to which corrected values are printed, though not accepted."""


@dataclass(frozen=True, eq=False)
class Rivals:
    """The best explanations of other kinds in place of one that was kept."""

    before: float
    """Ratio without that explanation."""
    others: tuple[State, ...]
    """States with another one in its place, best first; it is the last explanation of each."""
    alone: bool
    """Whether none of the others does nearly as well."""


@dataclass(frozen=True, eq=False)
class Rounds:
    """Result of the rounds."""

    before: State
    """State before any correction by the fit."""
    after: State
    rivals: tuple[Rivals, ...]
    """For each explanation of `after` that the fit found."""

    def undecided(self, search: Search) -> tuple[State, ...]:
        """States with another explanation in place of one that was kept, between which the data do not decide.

        Of another cause, or a filter of the same stream in place of a delay.
        """
        limit = ALONE * max(self.after.excess, LEAST_EXCESS)
        others = (*(state for one in self.rivals for state in one.others), *search.other_kinds(self.after))
        return tuple(state for state in others if state.excess < limit)


def explained(search: Search, before: State) -> Rounds:
    """The explanations of a misfit; none where the form is right or nothing explains enough."""
    now = before
    tried: list[State] = []
    given = len(before.explanations)
    while now.test.doubted and len(now.explanations) < given + MOST_ROUNDS:
        found = search.compared(search.others(now))
        best = found[0] if found and _worth(found[0], now, now is before) else now
        finer = search.finer(now)
        if finer is not None and ALONE * finer.excess < best.excess:
            now = search.fitted(finer.explanations, finer)
            continue
        if now.excess - best.excess < EXPLAINS * now.excess:
            best = _together(search, before, now, 0.5 * best.excess) or best
        if best is now:
            break
        tried, now = found, best if best.own_knots else search.fitted(best.explanations, best)
    if now.test.doubted and now is not before:
        together = _together(search, before, now, (1 - FURTHER) * now.excess)
        now = now if together is None else search.fitted(together.explanations, together)
    if len(now.explanations) == given + 1 and tried:
        return Rounds(before, now, (_rivals(before, now, now.explanations[-1], tried),))
    return _without_needless(search, before, now)


def _together(search: Search, before: State, now: State, limit: float) -> State | None:
    """`now` with all properties of the muscle, in their finest forms if one was found already and coarser ones fail;
    None if the result is not plausible for a muscle, or its excess not below `limit`.
    """
    known, mine = {one.family for one in now.explanations}, now.explanations[len(before.explanations) :]
    more = [one for one in ALL_OF_MUSCLE if one.family not in known]
    together = search.with_more(now, now.explanations, more) if more else now
    if mine and all(one.of_muscle for one in mine) and together.test.ratio >= STILL_APART * together.test.most_ratio:
        finest = search.with_more(now, before.explanations, FINEST)
        together = finest if ALONE * finest.excess < together.excess else together
    sound = together.excess < limit and all(plausible(one) for one in together.explanations)
    return together if sound else None


def _worth(found: State, now: State, first: bool) -> bool:
    """Whether an explanation of a round, the `first` or a later one, removes enough to be kept.

    A fault of the bench has an exact form and removes nearly all of its effect. A small part of any misfit looks like
    some delay.
    """
    further = FURTHER if found.last.of_muscle else EXPLAINS
    return now.excess - found.excess >= (0.0 if first else further) * now.excess


def _rivals(without: State, now: State, kept: Explanation, tried: Sequence[State]) -> Rivals:
    others = tuple(state for state in tried if state.last.cause != kept.cause)
    limit = ALONE * max(now.excess, LEAST_EXCESS)
    alone = not others or others[0].excess >= limit
    return Rivals(without.test.ratio, others, alone)


def _without_needless(search: Search, before: State, now: State) -> Rounds:
    """Rounds without explanations that are not needed or would not be added last; the others are compared with
    alternatives in their place.
    """
    given, found = before.explanations, []
    for one in now.explanations[len(given) :]:
        rest = tuple(other for other in now.explanations if other is not one)
        without = search.state(rest, now.test.fit, now.test.expected)
        removed = without.excess - now.excess
        if not (now.test.doubted or without.test.doubted) or removed < FURTHER * without.excess:
            return _without_needless(search, before, search.fitted(rest, without))
        found.append(_rivals(without, now, one, search.others(without, one.cause)))
    return Rounds(before, now, tuple(found))
