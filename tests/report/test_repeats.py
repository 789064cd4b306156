"""Repeats of an operating point over each other: which trials they are, how far apart, and what the first one is off."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.shared.trials import repeat_traces
from pmabench.report.figures.coefficient_figures import repeats
from pmabench.store.analyses.results import Analysis, Trace
from tests.report.samples import run

KIND = "contraction-relaxation"


def trial_at(like, index, P, size, **more):
    """x = size (1 - exp(-t)) from the trial's start on."""
    t = np.arange(0.0, 10.0, 0.01) + 100.0 * index
    x = size * -np.expm1(-(t - t[0]))
    flags = np.zeros(len(t), np.uint16)
    usual = {"status": "finished", "again": False, "reference": False}
    point = {"pressure": P, "load": 100.0}
    given = {"index": index, "point": point, "t": t, "channels": {"displacement": x}, "flags": flags, "commands": ()}
    return replace(like, **given, **usual | more)


def of(*trials):
    like = run(KIND)
    made = tuple(trial_at(like.trials[0], i, *trial[:2], **(trial[2] if len(trial) > 2 else {}))
                 for i, trial in enumerate(trials))  # fmt: skip
    return repeat_traces("displacement", [replace(like, trials=made)])


def test_the_point_with_most_repeats_is_shown():
    (trace,) = of((1e5, 0.01), (2e5, 0.02), (2e5, 0.02), (3e5, 0.03), (2e5, 0.02), (3e5, 0.03))
    assert trace.title == "pressure 200 kPa, load 100 N: 3 repeats over each other"
    assert [name for name in trace.columns if name != "t"] == ["repeat 1", "repeat 2", "repeat 3"]
    assert float(trace.columns["repeat 3"][-1]) == pytest.approx(0.02, abs=1e-5)


def test_trials_of_reference_and_those_that_ended_early_are_no_repeats():
    assert of((1e5, 0.01), (1e5, 0.01, {"reference": True}), (1e5, 0.01, {"again": True})) == []
    assert of((1e5, 0.01), (1e5, 0.01, {"status": "aborted"})) == []
    assert of((1e5, 0.01), (2e5, 0.01)) == []
    like = run(KIND)
    assert repeat_traces("", [replace(like, trials=(like.trials[0],) * 2)]) == []


def test_scatter_and_first_repeat_are_those_of_the_numbers():
    """Levels 0.3, 0.1 and -0.1 mm about 20 mm: standard deviation 0.2 mm; the first is 0.3 mm off the later ones."""
    t = np.linspace(0.0, 5.0, 50)
    levels = (20.3e-3, 20.1e-3, 19.9e-3)
    columns = {"t": t} | {f"repeat {n}": np.full(50, x) for n, x in enumerate(levels, 1)}
    quantities = {"t": "time"} | {f"repeat {n}": "length" for n in (1, 2, 3)}
    (picture,) = repeats(
        [Trace("repeats", "repeats", "300 kPa: 3 repeats", columns, quantities)], Analysis("any", (), simulated=True)
    )
    assert "Standard deviation between repeats 0.2 mm" in picture.caption
    assert "the first is 0.3 mm rms off the mean of the later ones" in picture.caption
    assert picture.alt.startswith("Contraction over time of 3 repeats at 300 kPa, which scatter by 0.2 mm")
    assert list(picture.table.columns) == ["time [s]", "repeat 1 [mm]", "repeat 2 [mm]", "repeat 3 [mm]"]
