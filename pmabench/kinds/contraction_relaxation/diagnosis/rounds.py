"""Why a fit fails: competing explanations, each with its correction, in at most four rounds.

In each round every explanation that is left is put in (`search`), and the one that predicts trials which were left out
best is kept. At the end each of those kept is taken out again and the others are tried in its place: where one does
nearly as well, nobody can tell which of both it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pmabench.kinds.contraction_relaxation.diagnosis.corrections import Explanation, plausible
from pmabench.kinds.contraction_relaxation.diagnosis.search import ALONE, LEAST_EXCESS, Search, State

MOST_ROUNDS = 4
EXPLAINS = 0.7
"""Share of the excess that an explanation removes to be one."""
FURTHER = 0.25
"""Share of what is left that another round removes to be kept, by a property of the muscle."""
STILL_TOLD = 1.25
"""Up to so many times the ratio at which the form is doubted, corrected values are printed, though not accepted."""


@dataclass(frozen=True, eq=False)
class Rivals:
    """An explanation that was kept, and the best of other kinds in its place."""

    kept: Explanation
    before: float
    """Ratio without it."""
    others: tuple[State, ...]
    """With others in its place, the best first; the last explanation of each is the other one."""
    alone: bool
    """Whether none of the others does nearly as well."""


@dataclass(frozen=True, eq=False)
class Rounds:
    """What the rounds found."""

    before: State
    """Without a correction by the fit."""
    after: State
    rivals: tuple[Rivals, ...]
    """For each explanation of `after` that the fit found."""

    def undecided(self, search: Search) -> tuple[State, ...]:
        """States with another explanation in place of one that was kept, which nobody can tell from it.

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
            together = _together(search, before, now)
            if together.excess < 0.5 * best.excess and all(plausible(one) for one in together.explanations):
                best = together
        if best is now:
            break
        tried, now = found, best if best.own_knots else search.fitted(best.explanations, best)
    if now.test.doubted and now is not before:
        together = _together(search, before, now)
        if together.excess < (1 - FURTHER) * now.excess and all(plausible(one) for one in together.explanations):
            now = search.fitted(together.explanations, together)
    if len(now.explanations) == given + 1 and tried:
        return Rounds(before, now, (_rivals(before, now, now.explanations[-1], tried),))
    return _without_needless(search, before, now)


def _together(search: Search, before: State, now: State) -> State:
    """`now` with all properties of the muscle, in finest forms where one is found already and coarser ones fail."""
    together, mine = search.all_of_muscle(now), now.explanations[len(before.explanations) :]
    if mine and all(one.of_muscle for one in mine) and together.test.ratio >= STILL_TOLD * together.test.most_ratio:
        finest = search.finest(before, now)
        if ALONE * finest.excess < together.excess:
            return finest
    return together


def _worth(found: State, now: State, first: bool) -> bool:
    """Whether an explanation of a round, the first one or a further, removes enough to be kept.

    A fault of the bench has an exact form, and removes nearly all of what it makes. A small part of a misfit that
    something else makes always looks like some delay.
    """
    further = FURTHER if found.last.of_muscle else EXPLAINS
    return now.excess - found.excess >= (0.0 if first else further) * now.excess


def _rivals(without: State, now: State, kept: Explanation, tried: Sequence[State]) -> Rivals:
    others = tuple(state for state in tried if state.last.cause != kept.cause)
    limit = ALONE * max(now.excess, LEAST_EXCESS)
    alone = not others or others[0].excess >= limit
    return Rivals(kept, without.test.ratio, others, alone)


def _without_needless(search: Search, before: State, now: State) -> Rounds:
    """Explanations that are not needed, or would not be put in last, are taken out, the others compared with others in
    their place.
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
