"""`pmabench model` with the muscle of an analysis: shown, evaluated, simulated; a validation of it.

The truth is the muscle of the mock bench, whose force is written out in `test_process_surface`.
"""

import json

import pandas as pd
import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from tests.cli.conftest import ran
from tests.cli.test_process_surface import force, stiffness

STEPS = [
    ("sweep.matrix.load", "[20.6 kg]"),
    ("sweep.matrix.pressure", "[250 kPa, 400 kPa]"),
    ("sample_rate", "100 Hz"),
    ("trial.hold", "4 s"),
    ("trial.window", "[3 s, 4 s]"),
]


def model(*arguments):
    return CliRunner().invoke(main, ["model", *map(str, arguments)])


def answer(*arguments):
    result = model(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return {column["name"]: column["values"] for column in json.loads(result.stdout)["columns"]}


def test_force_and_stiffness_are_those_of_the_muscle(surface):
    table = answer("eval", surface, "--set", "pressure=350 kPa", "--over", "displacement=10 mm..30 mm by 5 mm")
    for x, F, K in zip(table["displacement"], table["force"], table["stiffness"], strict=True):
        assert force(x, 350e3) == pytest.approx(F, abs=8.0)
        assert stiffness(x, 350e3) == pytest.approx(K, rel=0.04)
    shown = model("show", surface)
    assert shown.exit_code == 0, shown.output
    assert "Trials that were left out of the fit were predicted to" in shown.stdout
    beyond = model("eval", surface, "--set", "pressure=700 kPa")
    assert beyond.exit_code == 2
    assert "beyond what was tested" in beyond.output


def test_tables_of_other_programs_hold_the_force_of_the_muscle(surface, tmp_path):
    """A row per 1 mm where rows of the tests lie; in display units as CSV, SI with units as Parquet."""
    for form in ("csv", "parquet"):
        written = CliRunner().invoke(main, ["export", str(surface), "--format", form, "-o", str(tmp_path / form)])
        assert written.exit_code == 0, written.output
    shown = pd.read_csv(tmp_path / "csv/surface/surface.csv")
    assert list(shown.columns) == ["P [kPa]", "x [mm]", "F [N]", "K [N/mm]"]
    table = pd.read_parquet(tmp_path / "parquet/surface-table.parquet")
    assert len(table) == len(shown) > 200
    assert table["contraction [m]"].max() > 45e-3
    for row, (P, x, F, K) in enumerate(table.itertuples(index=False)):
        assert pytest.approx(force(x, P), abs=3.0) == F
        assert pytest.approx(stiffness(x, P), rel=0.06) == K
        assert shown.iloc[row].tolist() == pytest.approx([P / 1e3, 1e3 * x, F, K / 1e3])


def test_a_pressure_is_found_behind_forces(surface, tmp_path):
    table = tmp_path / "rows.csv"
    rows = [(x, force(1e-3 * x, 300e3)) for x in (5, 10, 15, 20, 30)]
    table.write_text("displacement [mm],force [N]\n" + "".join(f"{x},{F}\n" for x, F in rows))
    result = model("fit", surface, table, "--free", "pressure", "--json")
    assert result.exit_code == 0, result.output
    (pressure,) = json.loads(result.stdout)["parameters"]
    assert pressure["value"] == pytest.approx(300e3, abs=2e3)
    assert "--form surface" in model("show", surface).output


def test_steps_of_a_run_that_it_was_not_fitted_to(surface, tmp_path):
    """A free end under a weight: within 1 % of the stroke."""
    run = ran(tmp_path / "runs", "validation", "mock-real", [("model.coefficients", str(surface)), *STEPS])
    processed = CliRunner().invoke(main, ["process", run, "--json"])
    (analysis,) = json.loads(processed.stdout)["analyses"]
    rms = {
        e["method"]: e["value"] for e in analysis["estimates"] if (e["symbol"], e["at"]["pressure"]) == ("e_sim", 4e5)
    }
    assert rms["measured pressure"] < 0.4e-3


def test_pressures_and_loads_may_be_made_up(surface):
    table = answer("simulate", surface, "--step", "300 kPa at 0.1 s", "--load", "20 kg", "--for", "6 s")
    assert table["force"][-1] == pytest.approx(20 * 9.81, abs=0.5)
    x = table["displacement"][-1]
    held = 5.0 + 0.05 * 300 + 18.0  # both loops at their ends on the way there
    assert force(x, 300e3) - held == pytest.approx(20 * 9.81, abs=6.0)
    high = model("simulate", surface, "--step", "700 kPa at 0.1 s")
    assert high.exit_code == 2
    assert "up to which it was tested" in high.output


def test_an_analysis_without_a_surface_is_refused(tmp_path):
    assert "no muscle as a surface" in model("show", tmp_path).output
