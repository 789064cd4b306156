"""Which column is time, pressure, force, displacement, command: by its name, its unit and the shape of its numbers.

Pure functions of names and arrays; must not know files. Every choice carries its reasons, and doubts where it is weak.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import get_args

import numpy as np

from pmabench.store.importers.found import correlation
from pmabench.store.importers.guess import times
from pmabench.store.importers.guess.names import BRACKETS, WORDS, split_factor, unit_in, words
from pmabench.store.importers.guess.proposal import Proposal
from pmabench.store.importers.guess.shapes import by_shape, lattice
from pmabench.store.importers.map_file import QUANTITY, PointName, spelled
from pmabench.store.records import Array

OF_MUSCLE = {"pressure", "force", "length"}
FEW = 0.1
"""A column that numbers trials changes in less than this share of its rows."""


def proposal(name: str, values: Array, said: str = "", *, bare: bool = False) -> Proposal:
    """A column by its heading; `said`: its unit as the file gives it apart from the name, where it does."""
    own, heading = f"[{said}]", f"{name} [{said}]" if said else name
    column = Proposal(name, values, unit=spelled(said) or unit_in(own) or unit_in(name), bare=bare)
    column.factor = split_factor(own)[1] or split_factor(heading)[1]
    texts = [] if column.unit else BRACKETS.findall(heading)
    column.strange = next((text[1:-1] for text in texts if re.search(r"[^\W\d_]", text)), "")
    return column


def choose(proposals: Sequence[Proposal]) -> None:
    """Give every column its role; at most one of each."""
    proposals = [proposal for proposal in proposals if not _exported(proposal)]
    for proposal in proposals:
        if not proposal.bare:
            _by_name(proposal)
    times.choose(proposals)
    _one_each(proposals)
    for proposal in by_shape(proposals):
        if step := lattice(proposal.good):
            text = f"reads in steps of {step:.4g}: counts were turned into it; where you know the line say it with "
            proposal.doubts.append(f'{text}"recorded_with"')
    _unknown(proposals)


def _exported(proposal: Proposal) -> bool:
    """Whether it is a column that `pmabench export` adds to the channels: it gets its role."""
    name, of = proposal.name, re.fullmatch(r"trial (\w+)(?: \[.*\])?", proposal.name)
    if name in ("trial", "flags", "simulated"):
        proposal.role = name
    elif of is not None and of[1] in get_args(PointName):
        proposal.role, proposal.extra = "point", [f"of: {of[1]}"]
    return proposal.role in ("trial", "flags", "simulated", "point")


def _unknown(proposals: Sequence[Proposal]) -> None:
    """Doubt and question for columns that vary with the pressure and were not recognised."""
    pressure = next((p for p in proposals if p.role == "pressure"), None)
    for proposal in proposals:
        if (
            proposal.role != "ignore"
            or pressure is None
            or proposal.reasons
            or len(pressure.values) != len(proposal.values)
        ):
            continue
        together = correlation(proposal.values, pressure.values)
        if abs(together) > 0.8:
            proposal.doubts.append(f"goes with the pressure (correlation {together:.2f}): is it force or displacement?")
            if all(p.role != "force" for p in proposals):
                text = (
                    f'"{proposal.name[:40]}" goes with the pressure (correlation {together:.2f}), and nothing names it'
                )
                proposal.question = f"{text}: is it {{is: force, unit: N}}, {{is: displacement, unit: mm}}, or ignore?"
        else:
            proposal.reasons.append("neither its name nor its unit nor its numbers show what it is")


def _by_name(proposal: Proposal) -> None:
    own = words(proposal.name)
    quantity = QUANTITY.get(proposal.unit, "")
    hits = {role for role, known in WORDS.items() if own & known}
    text = f'called "{proposal.name[:40]}"' + (f", in {proposal.unit}" if proposal.unit else "")
    role = "ignore"
    if quantity == "time" or (hits - {"trial"} == {"time"} and quantity == ""):
        role = "time"
    elif quantity == "flow" or ("flow" in hits and quantity in {"", "reading"}):
        role = "flow"
    elif hits - {"other"} == {"trial"} and quantity == "" and _numbers_trials(proposal.good):
        role = "trial"
        if proposal.good.min() == 0:
            proposal.doubts.append("0 means no trial; where it is the first one, number the trials from 1")
    elif "ambient" in hits or ("other" in hits and not ("pressure" in hits or quantity in OF_MUSCLE)):
        proposal.reasons.append(f"{text}: none of the channels of a muscle's test")
        return
    elif quantity == "pressure" or (quantity in {"", "reading"} and "pressure" in hits):
        role = "supply" if "supply" in hits else "pressure_command" if "command" in hits else "pressure"
    elif quantity == "length" or (quantity in {"", "reading"} and hits & {"displacement"} and not hits & {"force"}):
        role = "displacement_command" if "command" in hits else "displacement"
    elif quantity == "force" or ("force" in hits and quantity in {"", "reading", "mass"}):
        role = "ignore" if hits & {"command", "not measured"} else "force"
        if role == "ignore":
            proposal.reasons.append(f"{text}: a force that nobody measured")
    elif hits & {"command", "time"} == {"command"} and quantity in {"", "reading"}:
        role = "pressure_command"
    elif "phase" in hits and quantity == "":
        role = "phase"
    proposal.role = role
    if role != "ignore":
        proposal.reasons.append(text)


def _numbers_trials(values: Array) -> bool:
    """Whether a column holds whole numbers that rarely change."""
    changes = int(np.count_nonzero(np.diff(values)))
    return len(values) > 1 and bool(np.all(values == np.round(values))) and changes < FEW * len(values)


def _one_each(proposals: Sequence[Proposal]) -> None:
    """Where several columns have one role, the one that moves most keeps it, with a doubt."""
    for role in dict.fromkeys(p.role for p in proposals if p.role not in {"ignore", "time"}):
        same = [p for p in proposals if p.role == role]
        if len(same) < 2:
            continue
        best = max(same, key=lambda p: (len(words(p.name) & WORDS.get(role, set())), bool(p.unit), _moves(p.good)))
        for proposal in same:
            if proposal is not best:
                proposal.role = "ignore"
                proposal.doubts.append(f'may be {role.replace("_", " ")} too; "{best.name[:40]}" is taken')
        best.doubts.append(f"{len(same)} columns look like {role.replace('_', ' ')}; this one was taken")
        if role in {"pressure", "force", "displacement"}:
            names = ", ".join(f'"{p.name[:40]}"' for p in same if p is not best)
            text = (
                f'is "{best.name[:40]}" the measured {role}? It moves most against its scatter, but {names} may be it'
            )
            best.question = f"{text}; then write ignore here and {role} there"
    pressure = [p for p in proposals if p.role == "pressure"]
    spare = [p for p in proposals if p.role in {"supply", "pressure_command"}]
    if not pressure and spare:
        spare[0].doubts.append(f"no measured pressure was found; is it this {spare[0].role.replace('_', ' ')}?")


def _moves(values: Array) -> float:
    """How far a channel moves, against the scatter from sample to sample."""
    if len(values) < 3:
        return 0.0
    scatter = float(np.median(np.abs(np.diff(values)))) or 1e-12
    return float(np.ptp(np.quantile(values, [0.01, 0.99]))) / scatter
