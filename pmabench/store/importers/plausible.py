"""Whether a file can be what its map says, by itself: runs the checks of several channels against each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from pmabench.store.importers import frozen, lag, magnitude, midfile
from pmabench.store.importers.effect import add_effects
from pmabench.store.importers.found import Bools, Checked, Found, Report
from pmabench.store.importers.magnitude import Muscle
from pmabench.store.importers.questions import Question
from pmabench.store.records import UNUSABLE, Array, Flags

CONDEMNED = 0.5
"""Share of flagged samples above which a file is not looked at any further: its faults are known."""


def stopped(t: Array, channels: Sequence[Checked], flags: Flags, held: bool) -> tuple[Flags, list[Found]]:
    """Flags of shape (n,) with those of frozen and clipped samples, and what was found; `t` [s] of a part of a file.

    `held`: the length of the muscle is set, so that force follows pressure.
    """
    report = Report(t, flags.copy())
    pair = _pair(channels, held)
    good = _good(flags, channels)
    if pair is not None and good.mean() > 1.0 - CONDEMNED:
        with np.errstate(all="ignore"):  # damaged files hold numbers of any size
            for one, other in (pair, pair[::-1]):
                frozen.frozen(report, one, other, good, follows=held)
                if held:
                    frozen.clipped(report, one, other, good)
            add_effects(report, channels)
    return report.flags, report.found


def judge(
    t: Array, channels: Sequence[Checked], flags: Flags, muscle: Muscle, confirmed: Collection[str] = ()
) -> tuple[list[Found], list[Question]]:
    """Findings and open questions of samples at `t` [s], shape (n,), of a whole file; none of them flags a sample.

    `confirmed`: kinds of findings that somebody has looked at and found right: they are notes, and withhold nothing.
    """
    with np.errstate(all="ignore"):  # damaged files hold numbers of any size
        found, questions = _judged(Report(t, flags), channels, muscle)
    return answered(found, confirmed), [each for each in questions if each.what not in confirmed]


def _judged(report: Report, channels: Sequence[Checked], muscle: Muscle) -> tuple[list[Found], list[Question]]:
    roles = {channel.rule.role: channel for channel in channels}
    good = _good(report.flags, channels)
    if good.mean() <= 1.0 - CONDEMNED or "pressure" not in roles:
        return [], []
    pair = _pair(channels, muscle.held)
    if not midfile.swapped(report, channels, good) and pair is not None:
        changed = midfile.jumped(report, *pair, good, follows=muscle.held)
        if muscle.held and not changed and not midfile.regained(report, *pair, good):
            lag.late(report, *pair, good)
    questions = magnitude.judge(report, roles, good, muscle)
    return report.found, questions


def _pair(channels: Sequence[Checked], held: bool) -> tuple[Checked, Checked] | None:
    """What follows pressure, the force of a muscle that is held or the displacement, and pressure."""
    roles = {channel.rule.role: channel for channel in channels}
    follower = roles.get("force" if held else "displacement")
    return (follower, roles["pressure"]) if follower is not None and "pressure" in roles else None


def _good(flags: Flags, channels: Sequence[Checked]) -> Bools:
    """Samples of which no flag forbids the use and every channel has a value."""
    good = (flags & np.uint16(UNUSABLE)) == 0
    for channel in channels:
        good &= np.isfinite(channel.si)
    return np.asarray(good)


def answered(found: Sequence[Found], confirmed: Collection[str]) -> list[Found]:
    """The findings, those of confirmed kinds as notes."""
    text = "{} (confirmed in the map)".format
    return [
        replace(each, level="note", withholds=False, text=text(each.text)) if each.kind in confirmed else each
        for each in found
    ]
