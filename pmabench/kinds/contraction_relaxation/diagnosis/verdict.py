"""The diagnosis of a contraction test: what was found and corrected, and what may be reported of it.

First the force cell against the weights (`cell`), then competing explanations of what the fit leaves (`search`), then
what is too small to be seen (`hiding`). docs/uncertainty.md has the rules in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.samples import NotUsable
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.diagnosis.cell import Weighed, readings, weighed
from pmabench.kinds.contraction_relaxation.diagnosis.columns import Span, bent, zero_known
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import (
    TITLES,
    TO_TELL,
    Named,
    forces_of,
    in_samples,
    named,
    shown,
)
from pmabench.kinds.contraction_relaxation.diagnosis.held_out import Spread
from pmabench.kinds.contraction_relaxation.diagnosis.hiding import GAIN, HARDLY, MOST_HIDDEN, ZERO, Hidden, Size
from pmabench.kinds.contraction_relaxation.diagnosis.search import (
    EXPLAINS,
    STILL_APART,
    Rivals,
    Rounds,
    Search,
    State,
    explained,
)
from pmabench.kinds.contraction_relaxation.intervals import Trust
from pmabench.kinds.contraction_relaxation.segments import Campaign, Cut, Segments
from pmabench.store.analyses.results import Estimate, Finding
from pmabench.store.records import Array

NEARLY = 0.9
"""Share of the excess that must be explained for values to be printed although the form is still doubted."""
SURE = 2.0
"""Smallest size of an explanation, in its standard deviations."""
NOT_STRAIGHT = "bend of K and B alike, which may be of the displacement sensor"
"""Title of `sensor` next to another explanation."""
REMEDY = "Look for the cause, mend it and measure again, or repeat trials if they differ by themselves"
SURFACE = "`pmabench process RUN... --form surface` describes a muscle that does not follow this form"
MOST_NAMED = 3
MANY = 3
"""Number of causes from which on values are not accepted: several rarely act at once; each absorbs part of others."""
BEND_POINTS = 33
"""Number of contractions at which a bend is recorded, from 0 to a tenth beyond those tested."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Diagnosis of a campaign."""

    search: Search
    weighed: Weighed
    rounds: Rounds
    of_cell: tuple[Named, ...]
    """Faults of the cell that the weights show; corrected."""
    of_fit: tuple[Named, ...]
    """Explanations of the fit's misfit; corrected."""
    spread: Spread | None = None
    """Effect of the correction on intervals; None without one."""
    hidden: Hidden = field(default_factory=lambda: Hidden((), (), ""))

    def corrected(self, segments: Segments) -> Segments:
        """Segments of corrected samples, minus the forces of the muscle beyond the straight form."""
        state = self.reported
        return segments.pulled(-forces_of(self.search.followed, segments, state.straight, state.explanations))

    @property
    def reported(self) -> State:
        """State from which values and figures come: the uncorrected one if values are withheld."""
        return self.rounds.before if self.state == "withheld" else self.rounds.after

    @property
    def ratio(self) -> float:
        """`Test.ratio` after all corrections, also where these are withheld."""
        return self.rounds.after.test.ratio

    @property
    def missed(self) -> str:
        """Start of a sentence about the ratio."""
        return (
            "trials that are left out of the fit are missed by"
            if self.rounds.after.test.held_out
            else "the residual is"
        )

    @cached_property
    def state(self) -> str:
        """`sound`, `corrected`, `undecided`, `doubtful` (printed, not accepted) or `withheld`."""
        test, before = self.rounds.after.test, self.rounds.before
        if not before.test.doubted:
            return "corrected" if self.of_cell else "sound"
        explained = self.rounds.after.excess <= (1 - (NEARLY if test.doubted else EXPLAINS)) * before.excess
        sure = all(abs(one.size) > SURE * one.error for one in self.of_fit)
        if not self.of_fit or not explained or not sure or test.ratio >= STILL_APART * test.most_ratio:
            return "withheld"
        alone = all(one.alone for one in self.rounds.rivals)
        if self.suspect or (test.ratio >= test.most_ratio and not alone):
            return "withheld"
        if test.doubted or len(self.of_fit) >= MANY:
            return "doubtful"
        return "corrected" if alone else "undecided"

    @property
    def suspect(self) -> bool:
        """Whether the list may lack a cause: the fit needs a fault of the bench and something else, or a bend that may
        be of the displacement sensor, whose scale would then be unknown.
        """
        mixed = len(self.of_fit) > 1 and not all(one.of_muscle for one in self.of_fit)
        return mixed or any(one.key == "sensor" for one in self.of_fit)

    @property
    def bent(self) -> bool:
        """Whether K changes over the tested contractions, so that it is not a single number."""
        return any(one.key == "bend" for one in self.of_fit)

    @property
    def factor(self) -> float:
        """Factor on intervals for the remaining misfit."""
        return max(1.0, self.ratio) if self.state == "doubtful" else 1.0

    @property
    def named(self) -> tuple[Named, ...]:
        """All that was corrected."""
        return (*self.of_cell, *self.of_fit)

    @property
    def fits(self) -> str:
        """Significant departures that are not corrected, in words, the clearest first; empty without."""
        return "; or that ".join(one.text for one in self.hidden.found[:MOST_NAMED])

    @property
    def misses(self) -> str:
        """Evidence against the form before any correction, with numbers; empty without."""
        test, parts = self.rounds.before.test, []
        if test.ratio >= test.most_ratio:
            limit = f"below {test.most_ratio:.3g} is expected"
            parts.append(f"{self.missed} {test.ratio:.3g} times what the noise allows ({limit})")
        if test.alike >= test.most_alike:
            limit = f"below {test.most_alike:.2g} is expected"
            parts.append(f"residuals of neighbouring segments agree by {test.alike:.2g} of the noise ({limit})")
        return "; ".join(parts)

    @property
    def reason(self) -> str:
        """Why nothing of the fit may be reported, with numbers; empty where something may."""
        if self.state != "withheld":
            return ""
        best = "; and that ".join(one.text for one in self.of_fit)
        if not best:
            cause = "the cause is unknown"
        elif self.rounds.after.test.doubted:
            cause = f"nearest to it is that {best}, which leaves {self.ratio:.3g} times the noise: the cause is unknown"
        else:
            cause = f"it would fit that {best}, of which these data do not make sure"
        return f"the data do not have the form of the model: {self.misses}; {cause}. {REMEDY}; {SURFACE}"

    @property
    def refusal(self) -> str:
        """Why values are reported, but not accepted; empty where they may be."""
        if self.state == "undecided":
            return f"the misfit is explained, but {self.between}: intervals reach over both"
        if self.state == "doubtful" and not self.rounds.after.test.doubted:
            return f"the form does not hold; corrected for {self.titles}, which are not sure all at once"
        if self.state == "doubtful":
            left = f"{self.missed} {self.ratio:.3g} times what the noise allows"
            return f"the form does not hold; corrected for {self.titles}, {left}: intervals are wider by that"
        if self.state == "corrected" and self.bent:
            return "K changes over the contractions tested: it is the slope at one of them, and not one number"
        return ""

    @property
    def titles(self) -> str:
        """Names of all that was corrected."""
        return ", ".join(dict.fromkeys(TITLES[one.key] for one in self.named))

    @property
    def note(self) -> str:
        """Note on every value; empty where nothing was corrected."""
        return "" if self.state == "withheld" or not self.named else f"corrected for {self.titles}"

    def stiffness_is(self, P: float) -> str:
        """Which K the value at a pressure [Pa] is, in words; empty where there is only one."""
        x, creeps = self.slope_at(P), any(one.key == "creep" for one in self.of_fit)
        found = [] if x is None else [f"the slope at {show(x, 'length', 3)}"]
        found += ["before any creep"] if creeps and self.note else []
        return f"K is {', '.join(found)}" if found else ""

    @cached_property
    def _span(self) -> Span:
        return Span.of(self.reported.test.segments)

    def slope_at(self, P: float) -> float | None:
        """Contraction [m] at which K at a pressure [Pa] is the slope; None where K is the same everywhere."""
        if self.state == "withheld" or not self.bent:
            return None
        return float(self._span.middle(np.array([P]))[0])

    def more(self, x: Array, P: Array) -> Array:
        """Force of the fitted muscle beyond F_ce - K x because of its bend [N], at contractions [m] and pressures [Pa],
        shape (n,).
        """
        test, found = self.reported.test, np.zeros(len(x))
        for one in self.reported.explanations:
            if one.kind == "bend":
                shapes = bent(one.which, x, P, test.fit.values("K", P), self._span)
                found = found + shapes @ np.array(one.sizes)
        return found

    def force_at(self, P: float, x: float) -> float:
        """Force of the fitted muscle [N] at rest at a pressure [Pa] and a contraction [m], including its bend."""
        there, at = np.array([x]), np.array([P])
        F_ce, K = (self.reported.test.fit.values(symbol, at) for symbol in ("F_ce", "K"))
        return float((F_ce - K * there + self.more(there, at))[0])

    def _bend(self) -> dict[str, Any]:
        """Force beyond F_ce - K x [N] over contraction [m] at each tested pressure [Pa], as plain data."""
        tested = [P for P in self.reported.test.campaign.tested if self.slope_at(P) is not None]
        if not tested:
            return {}
        segments = self.reported.test.segments
        x = np.linspace(0.0, 1.1 * float(np.max(segments.contraction)), BEND_POINTS)
        more = [self.more(x, np.full(len(x), P)).tolist() for P in tested]
        return {"contraction": x.tolist(), "pressure": tested, "force": more}

    @property
    def between(self) -> str:
        """`undecided between A and B`; empty where it is decided."""
        pairs = zip(self.of_fit, self.rounds.rivals, strict=True)
        found = [(TITLES[one.key], _title(rival.others[0])) for one, rival in pairs if not rival.alone]
        return "; ".join(f"undecided between {one} and {other}" for one, other in found)

    def hides(self, estimates: Sequence[Estimate]) -> dict[int, str]:
        """Index of each value that must be withheld although the form holds as a whole -> reason.

        Values affected by one departure share a reason, with the largest relative change among them.
        """
        found: dict[int, tuple[Size, float]] = {}
        for place, estimate in enumerate(estimates):
            lines = {s.name: s.half or 0.0 for s in estimate.budget}
            mine = [(one, lines.get(one.cause.name, 0.0)) for one in self.hidden.found]
            one, half = max(mine, key=lambda pair: pair[1], default=(None, 0.0))
            if one is not None and estimate.value is not None and half > MOST_HIDDEN * abs(estimate.value):
                found[place] = (one, half / abs(estimate.value))
        most = {id(one): max(share for other, share in found.values() if other is one) for one, _ in found.values()}
        return {place: _why_hidden(one, most[id(one)]) for place, (one, _) in found.items()}

    def findings(self, trust: Trust) -> Iterator[Finding]:
        """Results of the tests of the form and of the weights, what was corrected, and advice."""
        if self.reason:
            yield Finding("doubt", f"form: {self.reason}")
        else:
            yield from self._of_the_form()
        yield from self._of_the_weights({one.name for one in trust.causes if one.seen})

    def _of_the_form(self) -> Iterator[Finding]:
        rounds = self.rounds
        for one in self.named:
            of = "property of the muscle" if one.of_muscle else "fault of the bench"
            yield Finding("doubt", f"diagnosis, {of}: {one.text}; corrected. Advice: {one.advice}")
        if self.named:
            ratios = (one.test.ratio for one in (rounds.before, rounds.after))
            parts = ["missed by {:.3g} times the noise before, {:.3g} after".format(*ratios)] if rounds.rivals else []
            for one, rival in zip(self.of_fit, rounds.rivals, strict=True):
                for best in rival.others[:1]:
                    ratio = f"{best.test.ratio:.3g}"
                    parts.append(f"next best to {TITLES[one.key]} is {_title(best)}, {ratio}")
            which = f"; {self.between}" if self.between else ""
            yield Finding("note", f"diagnosis: {'; '.join(parts)}{which}")
        text = (
            f"form: {self.missed} {self.ratio:.3g} times what the noise allows, residuals of neighbouring segments"
            f" agree by {rounds.after.test.alike:.2g} of the noise"
        )
        if self.hidden.found:
            more = f"but it fits that {self.fits}. {self.hidden.moved}; it is a line of each interval"
            yield Finding("doubt", f"{text}; {more}")
        else:
            count = len(self.hidden.sizes)
            yield Finding("note", f"{text}; no departure of {count} moves a coefficient beyond its interval")

    def _of_the_weights(self, seen: Set[str]) -> Iterator[Finding]:
        """Contradictions between the force cell and the weights hung on it; `seen`: names of significant causes."""
        weighed = self.weighed
        if weighed.guide:
            size = show(weighed.guide, "force", 2)
            text = f"a guide between cell and weights rubs by about {size}: after the way down the cell reads twice"
            yield Finding("note", f"{text} that less than after the way up. F_c is without it")
        for name, found, quantity in ((GAIN, weighed.gain, "ratio"), (ZERO, weighed.offset, "force")):
            if name in seen and found is not None:
                size, unsure = (show(abs(value), quantity, 2) for value in (found[0], 2 * found[1]))
                way = "more" if found[0] > 0 else "less"
                text = f"{name}: it reads {size} {way} than they weigh, +- {unsure}, which its calibration does not"
                text += " allow: one of them is wrong, and the intervals hold both"
                if weighed.guide is None and found[0] > 0:
                    text += f"; or a guide between them rubs. To know, {TO_TELL}"
                yield Finding("doubt", text)
        if weighed.wrong is not None:
            load, off, error = weighed.wrong
            size, unsure = (show(value, "force", 2) for value in (abs(off), 2 * error))
            way = "more" if off > 0 else "less"
            text = f"the weight of {show(load, 'force', 4)} is {size} {way} by the force cell, +- {unsure}"
            yield Finding("doubt", f"{text}; the others agree. Weigh it; no value of the fit rests on its mark")

    @property
    def facts(self) -> dict[str, Any]:
        """The diagnosis as plain data, sizes in SI."""
        wrong = self.weighed.wrong
        return {
            "state": self.state,
            "ratio": self.ratio,
            "ratio_before": self.rounds.before.test.ratio,
            "held_out": self.rounds.after.test.held_out,
            "alike": self.rounds.after.test.alike,
            "explanations": [
                {"cause": one.key, "title": TITLES[one.key], "of": "muscle" if one.of_muscle else "bench",
                 "kind": one.explanation.kind, "which": one.explanation.which, "text": one.text, "size": one.size,
                 "error": one.error, "sizes": list(one.explanation.sizes), "advice": one.advice, **_rival(rival)}
                for one, rival in zip(self.named, (*(None for _ in self.of_cell), *self.rounds.rivals), strict=True)
            ],
            "K_at": [
                {"pressure": P, "contraction": x, "force": self.force_at(P, x)}
                for P in self.reported.test.campaign.tested
                if (x := self.slope_at(P)) is not None
            ],
            "bend": self._bend(),
            "wrong_weight": None if wrong is None else {"load": wrong[0], "off": wrong[1], "error": wrong[2]},
            "departures": [
                {"cause": s.cause.name, "text": s.text, "size": s.size, "error": s.error, "beyond": s.beyond}
                for s in self.hidden.sizes
            ],
        }  # fmt: skip


def _rival(rival: Rivals | None) -> dict[str, Any]:
    """The ratio without an explanation of the fit, whether it is the only one, and the next best in its place; None for
    what the weights show.
    """
    best = rival.others[0] if rival and rival.others else None
    return {
        "alone": rival is None or rival.alone,
        "ratio_without": rival and rival.before,
        "runner_up": best and _title(best),
        "runner_up_ratio": best and best.test.ratio,
    }


def _title(state: State) -> str:
    last = state.last
    if last.cause == "late pressure" and last.sizes[0] < 0:
        return TITLES["tube"]
    return NOT_STRAIGHT if last.kind == "sensor" else TITLES[last.cause]


def _why_hidden(one: Size, share: float) -> str:
    """Why values are withheld that a departure could change by up to this share."""
    effect = f"could change these values by up to {100 * share:.2g} %"
    limit = f"more than {100 * MOST_HIDDEN:g} % is not left to an interval"
    if one.share < HARDLY:
        most = one.way.text.format(size=shown(one.hidden, one.way.quantity))
        return (
            f"it cannot be excluded that {most}: these trials hardly distinguish that from the coefficients, and it"
            f" {effect} ({limit}). Test at more loads, which differ more"
        )
    return f"it fits that {one.text}, which {effect} ({limit}). {REMEDY}"


TURNED = (
    "the force cell reads less the more weight hangs on it: its sign is wrong. Turn the sign in its calibration or map"
)


def examined(recorded: Campaign, knots: Array, segments_of: Cut, segments: Segments) -> Diagnosis:
    """The diagnosis of a campaign with these first knots [Pa]; `segments` are cut from the samples as recorded."""
    gain = Scales.of(recorded.runs).gains.get("force", 0.0)
    weights = weighed(readings(recorded), {"drift": zero_known(recorded), "gain": gain})
    if weights.gain is not None and weights.gain[0] < -1:
        raise NotUsable(TURNED)
    search = Search(in_samples(recorded, weights.found), segments_of, knots, weights.drift is None)
    if not weights.found:
        search.cuts[()] = recorded, segments
    rounds = explained(search, search.fitted(()))
    after = rounds.after
    known = weighed(readings(search.campaign)) if weights.found else weights
    of_cell = tuple(
        named(one, np.array([errors, -errors]), after.test.fit, 0.0)
        for one, errors in zip(weights.found, weights.errors, strict=True)
    )
    spread = Spread(search, rounds.before, after, segments, rounds.undecided(search), weights.unsure, 1.0)
    highest = max(recorded.tested)
    of_fit = tuple(
        named(one, off, after.test.fit, highest, recorded.name(int(one.which)) if one.kind == "slip" else "")
        for one, off in zip(after.explanations, spread.sizes(), strict=True)
    )
    found = Diagnosis(search, known, rounds, of_cell, of_fit)
    if not of_cell and not found.reported.explanations:
        return found
    return replace(found, spread=replace(spread, state=found.reported, factor=found.factor))
