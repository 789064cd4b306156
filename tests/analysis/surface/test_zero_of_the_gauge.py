"""The surface of tests whose gauge does not read 0 when the muscle is vented: F = 0.65 N/kPa (1 - x/60 mm) P - 30 N."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.shared.regulated import vented
from pmabench.kinds.reduce import reduce_together
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run

RATE, RAMP, TOP, REST = 25.0, 40e3, 400e3, 3.0
ZERO = 8e3
CORNERS = np.cumsum([0.0, REST, TOP / RAMP, REST, TOP / RAMP, REST])
T = np.arange(round(CORNERS[-1] * RATE)) / RATE
SENT = np.interp(T, CORNERS, [0.0, 0.0, TOP, TOP, 0.0, 0.0])


def force(P, x):
    return np.maximum(0.65e-3 * (1 - x / 0.06) * P - 30.0, 0.0)


def held(zero=0.0, declared=1.5e3, remains=0.0):
    """Two tests at each of four lengths; the gauge reads `zero` too much, and `remains` is left in the muscle."""
    rng, trials = np.random.default_rng(2), []
    for number, x in enumerate((0.0, 0.01, 0.02, 0.03) * 2):
        P = np.maximum(SENT, remains * (number % 4) / 3)
        channels = {
            "pressure": P + zero + rng.normal(0, 200, len(T)),
            "pressure_command": SENT,
            "displacement": x + rng.normal(0, 5e-6, len(T)),
            "force": force(P, x) + rng.normal(0, 0.3, len(T)),
        }
        begin = number * (CORNERS[-1] + 5.0)
        commands = tuple(
            Command(begin + CORNERS[at], "pressure", "ramp", to, TOP - to, phase, {"rate": RAMP})
            for at, to, phase in ((1, TOP, "fill"), (3, 0.0, "empty"))
        )
        trials.append(TrialData("a", number, {"contraction": x}, number // 4, False, "finished", begin + T, channels,
                                np.zeros(len(T), dtype=np.uint16), commands, {}))  # fmt: skip
    known = {"pressure": {"offset_uncertainty": declared, "gain_uncertainty": 0.005},
             "displacement": {"offset_uncertainty": 4e-5}, "force": {"offset_uncertainty": 1.0}}  # fmt: skip
    return as_run("isometric-pressurisation", trials, RATE, {}, known)


def test_a_gauge_off_0_is_in_every_force_of_the_surface():
    """2.9 half widths at 100 kPa, without a word; the kind alone said it."""
    (analysis,) = reduce_together("surface", [held(ZERO)])
    forces = [e for e in analysis.estimates if e.symbol == "F" and e.value is not None]
    assert len(forces) >= 4
    for e in forces:
        assert abs(e.value - force(e.at["pressure"], e.at["contraction"])) < e.parts.combined
    assert any("vented, the gauge reads 7.9 kPa" in f.text for f in analysis.findings)


@pytest.mark.parametrize("run", [held(), held(1e3), held(ZERO, declared=1e4), held(remains=ZERO)])
def test_a_gauge_that_reads_0_within_what_is_declared_is_not_said(run):
    """Nor air that remains in some tests: the one nearest to 0 counts."""
    assert vented(run) is None


def test_runs_that_are_never_vented_say_nothing():
    run = held(ZERO)
    trials = [replace(trial, channels={**trial.channels, "pressure_command": SENT + 1e5}) for trial in run.trials]
    assert vented(replace(run, trials=tuple(trials))) is None
