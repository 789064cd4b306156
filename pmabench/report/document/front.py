"""Whether the results are good, in a word and a sentence, and their key numbers; computes no estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pmabench.plotting import wording
from pmabench.plotting.wording import WITHHELD
from pmabench.report.document import tables
from pmabench.report.words import declared, is_headline
from pmabench.store.analyses.results import AGREEMENT, Analysis, Estimate
from pmabench.store.records import RunData

TILES = 8


@dataclass(frozen=True)
class Tile:
    """A key number of the first page."""

    symbol: str
    name: str
    value: str
    unit: str
    where: str


def tiles_of(analyses: Sequence[Analysis]) -> list[Tile]:
    """Key numbers: each headline symbol by the method of its test that comes first, at the middle of what was tested.

    Where that method found none (no limit cycle) there is none: what others give, as a simulation, is no key number.
    What is withheld is there without a value.
    """
    found = []
    analyses = [analysis for analysis in analyses if analysis.kind != AGREEMENT]  # differences, no values
    for symbol, result in declared(analyses).items():
        for analysis in (a for a in analyses if is_headline(a, symbol)):
            values = [e for e in analysis.estimates if e.symbol == symbol and "frequency" not in e.at]
            primary = [e for e in values if e.method == values[0].method]
            known = [e for e in primary if e.value is not None]
            members = [e for e in known if set(e.at) == set(known[0].at)]
            held = sum(e.withheld for e in primary)
            if members:
                found.append(_tile(members, result.title))
                break
            if held:
                method = wording.clean(primary[0].method, 60)
                found.append(Tile(wording.symbol_text(symbol), wording.clean(result.title), WITHHELD, "", method))
                break
    if any(tile.symbol in ("B_c", "B_r") for tile in found):
        found = [tile for tile in found if tile.symbol != "B"]
    return found[:TILES]


def _tile(members: list[Estimate], title: str) -> Tile:
    varying = [
        name for name in wording.in_order(members[0].at, members[0].at) if len({e.at[name] for e in members}) > 1
    ]
    members = sorted(members, key=lambda e: [e.at[name] for name in varying])
    middle = members[len(members) // 2]
    unit = wording.shown(middle.quantity, middle.unit)
    value = tables.cell(middle)
    shown_at = {
        name: middle.at[name] for name in (varying or wording.in_order(middle.at, ("pressure", "setpoint"))[:1])
    }
    where = ", ".join(part for part in (wording.point_text(shown_at), wording.clean(middle.method, 60)) if part)
    return Tile(wording.symbol_text(middle.symbol), wording.clean(title), value, unit.unit, where)


@dataclass(frozen=True)
class Verdict:
    """Whether the results are good, in a word and a sentence; `level` is `good`, `doubt` or `fault`."""

    level: str
    word: str
    text: str


def verdict_of(
    analyses: Sequence[Analysis], runs: Sequence[RunData], failed: Sequence[str], *, accepted: bool
) -> Verdict:
    """The worst that is known: acceptance, faults, runs that did not finish, doubts.

    `failed`: reasons why results are not accepted (limits not kept, withheld values, refusals); `accepted`: limits were
    given.
    """
    faults, doubts = (sum(f.level == level for a in analyses for f in a.findings) for level in ("fault", "doubt"))
    ended = (sum(run.status != "finished" for run in runs), "run did not finish", "runs did not finish")
    counts = ((len(failed), "reason", "reasons"), (faults, "fault", "faults"), ended, (doubts, "doubt", "doubts"))
    reasons = [f"{count} {one if count == 1 else several}" for count, one, several in counts if count]
    if not any(e.value is not None or e.withheld for a in analyses for e in a.estimates):
        return Verdict("fault", "No result", "; ".join(["no coefficient came out", *reasons]) + ".")
    if failed or faults:
        return Verdict("fault", "Not accepted" if failed else "Faults were found", "; ".join(reasons) + ".")
    if reasons:
        return Verdict("doubt", "Usable with care", "; ".join(reasons) + ".")
    limits = "The acceptance limits of the protocol are met" if accepted else "The protocol sets no acceptance limits"
    return Verdict("good", "Accepted" if accepted else "No doubt", f"{limits}; no fault and no doubt was found.")
