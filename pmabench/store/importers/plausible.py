"""Whether a file can be what its map says, by itself: runs the checks of several channels against each other."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pmabench.store.importers import frozen, lag, magnitude, midfile
from pmabench.store.importers.effect import add_effects
from pmabench.store.importers.found import Bools, Checked, Found, Report
from pmabench.store.importers.magnitude import Muscle
from pmabench.store.records import UNUSABLE, Array, Flags

CONDEMNED = 0.5
"""Share of flagged samples above which a file is not looked at any further: its faults are known."""


def judge(
    t: Array, channels: Sequence[Checked], flags: Flags, muscle: Muscle, confirmed: Collection[str] = ()
) -> tuple[Flags, list[Found], list[dict[str, str]]]:
    """Flags of shape (n,), findings and open questions of samples at `t` [s], whose `flags` are those of each channel.

    `confirmed`: kinds of findings that somebody has looked at and found right: they are notes, and withhold nothing.
    """
    report = Report(t, flags.copy())
    roles = {channel.rule.role: channel for channel in channels}
    questions: list[dict[str, str]] = []
    good = _good(report, channels)
    if good.mean() > 1.0 - CONDEMNED and "pressure" in roles:
        if not midfile.swapped(report, channels, good):
            _against_pressure(report, roles, good, muscle)
        questions = magnitude.judge(report, roles, _good(report, channels), muscle)
    add_effects(report, channels)
    return (
        report.flags,
        answered(report.found, confirmed),
        [each for each in questions if each["what"] not in confirmed],
    )


def _against_pressure(report: Report, roles: Mapping[str, Checked], good: Bools, muscle: Muscle) -> None:
    """Frozen, clipped, changed and late channels; without a force or displacement there is nothing to compare."""
    pressure = roles["pressure"]
    follower = roles.get("force") if muscle.held else roles.get("displacement")
    if follower is None:
        return
    for one, other in ((follower, pressure), (pressure, follower)):
        frozen.frozen(report, one, other, good, follows=muscle.held)
        if muscle.held:
            frozen.clipped(report, one, other, good)
    good = _good(report, list(roles.values()))
    changed = midfile.jumped(report, follower, pressure, good, follows=muscle.held)
    if muscle.held and not changed and not midfile.regained(report, follower, pressure, good):
        lag.late(report, follower, pressure, good)


def _good(report: Report, channels: Sequence[Checked]) -> Bools:
    """Samples of which no flag forbids the use and every channel has a value."""
    good = (report.flags & np.uint16(UNUSABLE)) == 0
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
