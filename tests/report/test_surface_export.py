"""The exported surface, run by python-control, against the muscle of `pmabench model simulate`, whose scheme is another."""

import json

import control
import numpy as np
import pytest

from pmabench.base.errors import UsageError
from pmabench.model.identified.muscle import IdentifiedMuscle
from pmabench.model.identified.plant import Path, free_run
from pmabench.notebook import Results
from pmabench.report.files.export import export_results
from pmabench.report.files.surface_model import force, parameters_of
from pmabench.store.analyses.results import Analysis
from tests.model.test_identified import muscle

MUSCLE = muscle(((1e-3, 10.0), (4e-3, 20.0)), ((20e3, 8.0),), ((0.5, 0.02), (5.0, 0.03)), (1500.0, 900.0))
FORM = {"pressure": [0.0, 600e3]} | {name: [1e3, 2e3] for name in ("F_ce", "K", "B_c", "B_r", "F_c")}


def analysis():
    facts = {"muscle": MUSCLE.to_dict(), "straight_form": FORM, "held_out_rms": 2.0, "straight_form_rms": 40.0}
    return Results((Analysis("surface", ("r--1",), True, (), facts=facts),), ())


def test_it_moves_as_our_own_simulation(tmp_path):
    (path,) = export_results(analysis(), "python-control", tmp_path / "muscle.py")
    text = path.read_text()
    assert "SIMULATED" in text
    assert "predicted to 2 N rms" in text
    names: dict = {"__name__": "muscle"}
    exec(compile(text, str(path), "exec"), names)
    dt = names["PARAMETERS"]["step"]
    t = np.arange(0, 3.0, dt)
    P = 250e3 + 150e3 * np.sin(2 * np.pi * 0.4 * t - np.pi / 2) + 30e3 * (1 - np.cos(2 * np.pi * 1.2 * t))
    P *= np.minimum(t / 0.2, 1.0)
    given = [P, np.full(len(t), 200.0)]
    found = control.input_output_response(names["muscle"], t, given, names["start"](), {"M": 20.0})
    ours, _ = free_run(MUSCLE, t, P, 200.0, 20.0)
    assert np.abs(found.outputs[0] - ours).max() < 0.05e-3
    assert np.ptp(ours) > 15e-3


def test_its_force_is_that_of_the_muscle_with_all_terms():
    """A surface and weights at random, at places inside and beyond what was tested."""
    rng = np.random.default_rng(3)

    def weights(*sizes):
        low, high = rng.uniform(0.01, 1.0, (2, len(sizes)))
        return {"sizes": list(sizes), "low": low.tolist(), "high": high.tolist()}

    data = MUSCLE.to_dict() | {"fast": 2.0, "settled": 3.0, "creep_P": weights(0.5, 8.0)}
    data |= {"heights": rng.normal(0, 300, MUSCLE.heights.shape).tolist(), "stops_x": weights(1e-3, 9e-3)}
    one = IdentifiedMuscle.of(data)
    p = parameters_of(one)
    for P, x in ((-2e3, 1e-3), (90e3, 3e-3), (350e3, 25e-3), (650e3, 64e-3)):
        path = Path(one, 0.9 * P, 0.8 * x)
        ahead = path.step(1e-9, P)
        path.arrive(ahead, x)
        theirs, _ = force(P, x, (path.stops_x, path.stops_P, path.lag_x, path.lag_P), p)
        assert theirs == pytest.approx(ahead.pull(x)[0], rel=1e-9)


def test_json_holds_the_whole_muscle(tmp_path):
    (path,) = export_results(analysis(), "json", tmp_path / "muscle.json")
    (one,) = json.loads(path.read_text())["analyses"]
    assert IdentifiedMuscle.of(one["facts"]["muscle"]).to_dict() == MUSCLE.to_dict()


def test_what_has_no_memory_is_refused(tmp_path):
    with pytest.raises(UsageError, match="remembers its past"):
        export_results(analysis(), "mujoco", tmp_path / "m.xml")


def test_the_same_analysis_gives_the_same_bytes(tmp_path):
    first, second = (export_results(analysis(), "python-control", tmp_path / f"{n}.py")[0] for n in "ab")
    assert first.read_bytes() == second.read_bytes()
