"""Zeros of cell and gauge by what they read at rest: taken off where nothing but a zero reads so, else left open.

A muscle shorter than its nominal length pulls nothing without pressure, and no gauge pressure is below 0. Knows tests;
computes no estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.isometric_lines import Groups, Test, line_of
from pmabench.analysis.shared.samples import noise_of
from pmabench.analysis.shared.trials import grouped, session_of
from pmabench.base.quantities import show
from pmabench.kinds.isometric_pressurisation.curve import pulling
from pmabench.kinds.isometric_pressurisation.form import STRETCHED, Departure, at_rest
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array

USED = 0.5
"""Share of the declared uncertainty of a zero from which on what is seen at rest is better known."""
CELL, GAUGE = "zero of the force cell", "zero of the gauge"
CHANNELS = {"force": "force cell", "pressure": "gauge"}
AT_NOMINAL = (
    "at rest without pressure the force cell reads {} at the nominal length: its zero, or tension in the muscle. The "
    "intervals hold both. Take the zero of the cell, or test a shorter length as well"
)
NOT_VENTED = (
    "vented, the gauge reads {}: its zero, or a regulator that does not vent. The intervals hold both. Vent the muscle "
    "and take the zero of the gauge"
)


def zeroed(groups: Groups, scales: Scales) -> tuple[Groups, list[Departure], list[Finding]]:
    """The tests with forces and pressures from their zeros; what may be a zero or real; what is to be said.

    A zero is that of a session. One within noise, or that uses up little of its calibration's uncertainty, stays.
    """
    known = {name: scales.offsets.get(name, 0.0) for name in CHANNELS}
    every = [test for tests in groups.values() for test in tests]
    slack = _beyond(every, STRETCHED)
    taken: dict[str, dict[str, float]] = {name: {} for name in CHANNELS}
    for session, mine in grouped(every, lambda test: session_of(test.run)).items():
        short = _beyond(mine, STRETCHED) or slack
        taken["force"][session] = _level(short, "force", USED * known["force"])
        taken["pressure"][session] = min(0.0, _level(mine, "pressure", USED * known["pressure"]))
    largest = {name: max(zeros.values(), key=abs, default=0.0) for name, zeros in taken.items()}
    said = [_said(name, zero, known[name]) for name, zero in largest.items() if zero]
    opened = []
    if F := _level([] if slack else _beyond(every, -STRETCHED), "force", known["force"]):
        opened.append(Departure(CELL, "calibration", lambda test: np.full(len(test.t), F), True, ""))
        said.append(Finding("doubt", AT_NOMINAL.format(show(F, "force", 2))))
    if (P := _level(every, "pressure", known["pressure"])) > 0:
        opened.append(Departure(GAUGE, "calibration", lambda test: -P * _slope(test), True, "", moves=True))
        said.append(Finding("doubt", NOT_VENTED.format(show(P, "pressure", 2))))
    moved = {x: [_moved(test, taken) for test in tests] for x, tests in groups.items()}
    return moved, opened, said


def _beyond(tests: Sequence[Test], least: float) -> list[Test]:
    """The tests at more than a contraction [m]."""
    return [test for test in tests if test.trial.point["contraction"] > least]


def _level(tests: Sequence[Test], name: str, known: float) -> float:
    """What a channel reads in all rests of some tests [SI], the nearest to 0 where it changes.

    0 where that is within noise or `known`, or is not seen before and after the ramps: then it may be hysteresis.
    """
    rests = [(which, read) for test in tests for which, _, read in at_rest(test, name)]
    reads = [read for _, read in rests]
    if len({which for which, _ in rests}) < 2 or min(reads) <= 0 <= max(reads):
        return 0.0
    noise = max(noise_of(test.F if name == "force" else test.P) for test in tests)
    level = float(np.median(reads)) if np.ptp(reads) < noise else min(reads, key=abs)
    return level if abs(level) > max(noise, known) else 0.0


def _slope(test: Test) -> Array:
    """DF/dP of a test [N/Pa] at its samples, one where it pulls and 0 where it does not."""
    rows = pulling(test)
    line = line_of(test.P[rows], test.F[rows])
    return np.where(rows, line.m if line else 0.0, 0.0)


def _moved(test: Test, taken: dict[str, dict[str, float]]) -> Test:
    """A test with its zeros taken off."""
    F, P = (taken[name][session_of(test.run)] for name in ("force", "pressure"))
    if not F and not P:
        return test
    channels = test.trial.channels
    channels = {**channels, "force": channels["force"] - F, "pressure": channels["pressure"] - P}
    return replace(test, trial=replace(test.trial, channels=channels), F=test.F - F, P=test.P - P)


def _said(name: str, zero: float, known: float) -> Finding:
    """That a zero was taken off, and whether it is beyond what its calibration says."""
    text = f"at rest without pressure the {CHANNELS[name]} reads {show(zero, name, 2)}: taken as its zero and taken off"
    if not 0 < known < abs(zero):
        return Finding("note", f"{text}. Take the zero before the tests")
    most = f"its calibration says at most {show(known, name, 2)}"
    return Finding("doubt", f"{text}; {most}. Take the zero before the tests, and calibrate it again")
