"""Isometric pressurisation with a cell that reads the pressure: the force rises while the muscle is slack.

F = S (P - P_0(x)), 0 where that is below, and the cell adds a share of the pressure.
"""

import numpy as np
import pytest

from pmabench.kinds.isometric_pressurisation.reduction import reduce
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run

AREA, TOP, RAMP, REST, RATE = 1.5e-3, 500e3, 20e3, 3.0, 50.0
"""[m2], [Pa], [Pa/s], [s], [Hz]"""
BEGINS = {0.0: 20e3, 0.01: 60e3, 0.03: 200e3, 0.04: 350e3}
"""Contraction [m] -> pressure at which the force begins [Pa]."""


def found(cross, seed=3):
    """p_0 of two tests at each length, as method and contraction -> estimate."""
    chance, trials, way = np.random.default_rng(seed), [], TOP / RAMP
    corners = np.cumsum([0.0, REST, way, REST, way, REST])
    t = np.arange(round(corners[-1] * RATE)) / RATE
    P = np.interp(t, corners, [0.0, 0.0, TOP, TOP, 0.0, 0.0])
    for number, x in enumerate([*BEGINS] * 2):
        begin = number * (t[-1] + 5.0)
        read = {
            "pressure": P + 300.0 * chance.standard_normal(len(t)),
            "force": np.maximum(AREA * (P - BEGINS[x]), 0.0) + cross * P + 0.3 * chance.standard_normal(len(t)),
            "displacement": x + 5e-6 * chance.standard_normal(len(t)),
        }
        commands = tuple(
            Command(begin + at, "pressure", "ramp", end, TOP - end, phase, {"rate": RAMP})
            for at, end, phase in ((corners[1], TOP, "fill"), (corners[3], 0.0, "empty"))
        )
        flags = np.zeros(len(t), dtype=np.uint16)
        trials.append(TrialData(
            "r1", number, {"contraction": x}, number // len(BEGINS), False, "finished", begin + t, read, flags, commands, {}
        ))  # fmt: skip
    known = {"pressure": {"offset_uncertainty": 1.5e3}, "force": {"offset_uncertainty": 1.0}}
    analysis = reduce([as_run("isometric-pressurisation", trials, RATE, {}, known)])
    return {(e.method, e.at["contraction"]): e for e in analysis.estimates if e.symbol == "p_0"}


@pytest.mark.parametrize("cross", [3e-5, 5e-5, 1e-4])
def test_a_force_that_rises_from_rest_on_does_not_show_where_the_muscle_begins(cross):
    """It was given at 9 kPa for 350 kPa, 18 half widths off; the line's zero is shifted by the force that is read."""
    begun = found(cross)
    for (method, x), e in begun.items():
        if method == "isometric-line" and not begun["force-threshold", x].withheld:
            continue  # what is read there is below the threshold
        assert e.withheld or e.ci95[0] <= BEGINS[x] <= e.ci95[1], (method, x, e.value, e.parts.combined)
        assert not e.withheld or "rises from the vented pressure on" in e.note
    assert all(begun["force-threshold", x].withheld for x in (0.03, 0.04))
    assert not any(begun[method, 0.0].withheld for method in ("force-threshold", "isometric-line"))


def test_a_cell_that_reads_no_pressure_gives_all():
    for (_, x), e in found(0.0).items():
        assert e.ci95[0] <= BEGINS[x] <= e.ci95[1]
        assert e.parts.combined < 3e3
