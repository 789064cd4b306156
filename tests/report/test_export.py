"""Exports hold the numbers of the record and of the analysis, with units, as other programs read them."""

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib
import mujoco
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from matplotlib.ft2font import FT2Font
from scipy.io import loadmat

import pmabench
from pmabench.base.errors import UsageError
from pmabench.base.quantities import QUANTITIES
from pmabench.cli.export import FORMATS
from pmabench.cli.main import main
from pmabench.notebook import Results
from pmabench.plotting.svg import GREEK
from pmabench.report.files.export import export_results, export_run, typeset
from pmabench.report.files.simulator_models import GRAVITY, control_model, mujoco_model, simulated
from pmabench.store.analyses.results import Analysis, Parts
from tests.store.runs import closed

from . import samples


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return pmabench.open_run(closed(tmp_path_factory.mktemp("run")))


RESULTS = Results(tuple(samples.all_analyses()), ())


def test_samples_come_back_as_they_were(run, tmp_path):
    first = run.streams[0]
    frame = run.stream(first)
    export_run(run, "csv", tmp_path / "csv")
    read = pd.read_csv(tmp_path / "csv" / f"{first}.csv")
    pd.testing.assert_frame_equal(read[list(frame.columns)], frame, check_dtype=False, rtol=1e-15, atol=0.0)
    assert set(read.columns) - set(frame.columns) >= {"trial"}
    export_run(run, "parquet", tmp_path / "pq")
    table = pq.read_table(tmp_path / "pq" / f"{first}.parquet")
    assert table.schema.field("pressure [Pa]").metadata[b"unit"] == b"Pa"
    assert table.schema.metadata[b"run"] == run.id.encode()
    np.testing.assert_array_equal(table.column("pressure [Pa]").to_numpy(), frame["pressure [Pa]"])
    (path,) = export_run(run, "mat", tmp_path / "x.mat")
    data = loadmat(path, squeeze_me=True, struct_as_record=False)
    stream = getattr(data[first.replace("-", "_")], "pressure")  # noqa: B009
    np.testing.assert_array_equal(stream, frame["pressure [Pa]"])
    assert getattr(data[first.replace("-", "_")].units, "pressure") == "Pa"  # noqa: B009
    assert list(np.atleast_1d(data["trials"].trial)) == list(run.trials.index)


@pytest.mark.parametrize("form", ["csv", "parquet", "mat"])
def test_the_same_run_gives_the_same_bytes(run, tmp_path, form):
    one, two = (export_run(run, form, tmp_path / name) for name in ("a", "b"))
    assert [p.read_bytes() for p in one] == [p.read_bytes() for p in two]


def test_coefficients_come_back_with_their_units(tmp_path):
    K = next(e for e in samples.contraction().estimates if e.symbol == "K" and e.at["pressure"] == 400e3)
    export_results(RESULTS, "csv", tmp_path / "csv")
    read = pd.read_csv(tmp_path / "csv" / "contraction-relaxation" / "coefficients.csv")
    row = read[(read["method"] == "measured-pressure") & (read["P [kPa]"] == 400)].iloc[0]
    assert row["K [N/mm]"] == pytest.approx(K.value / 1e3)
    export_results(RESULTS, "parquet", tmp_path / "pq")
    table = pq.read_table(tmp_path / "pq" / "estimates.parquet").to_pandas()
    mine = table[(table.symbol == "K") & (table["pressure [Pa]"] == 400e3) & (table.method == "measured-pressure")]
    assert (mine.value.iloc[0], mine.unit.iloc[0]) == (K.value, "N/m")
    export_results(RESULTS, "mat", tmp_path / "x.mat")
    data = loadmat(tmp_path / "x.mat", squeeze_me=True, struct_as_record=False)["contraction_relaxation"].estimates
    assert K.value in data.value[data.symbol == "K"]
    assert data.units.pressure == "Pa"
    export_results(RESULTS, "json", tmp_path / "x.json")
    reported = json.loads((tmp_path / "x.json").read_text())
    assert [a["kind"] for a in reported["analyses"]] == [a.kind for a in RESULTS.analyses]


def test_latex_tables_hold_plain_numbers_and_balance(tmp_path):
    (path,) = export_results(RESULTS, "latex", tmp_path / "t.tex")
    text = path.read_text()
    assert r"$K$ [N/mm]" in text
    assert r"7.552 $\pm$ 0.021" in text
    assert "(simulated)" in text
    assert "siunitx" not in text
    assert text.count("{") == text.count("}")
    for body in re.findall(r"\\begin\{tabular\}\{([lr]+|(?:[lr]|p\{58pt\})+)\}(.*?)\\end\{tabular\}", text, re.DOTALL):
        columns, rows = body
        for row in re.findall(r"^(.*) \\\\$", rows, re.MULTILINE):
            assert len(re.split(r"(?<!\\)&", row)) == len(re.sub(r"p\{58pt\}", "p", columns))


def wide(cell: str, size: float) -> float:
    """Width [pt] of a cell, by the metrics of Computer Modern that matplotlib brings; its small sizes are wider."""
    font = FT2Font(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "cmr10.ttf"))
    font.set_size(100, 72)
    signs = len(re.findall(r"\\(pm|times|varepsilon|tau|theta|omega|ldots)", cell))
    plain = re.sub(r"\\cdot", ".", re.sub(r"\\(pm|times|varepsilon|tau|theta|omega|ldots|mathrm|circ)", "", cell))
    font.set_text(re.sub(r"[${}\\^_]", "", plain), 0.0)
    return (font.get_width_height()[0] / 64 / 100 + 0.778 * signs) * size


@pytest.mark.parametrize("column", [229.5, 252.0], ids=["article, two columns", "IEEEtran"])
def test_latex_tables_fit_a_column(tmp_path, column):
    """cmr8 is 1.063 times as wide as cmr10 at its size, cmr7 1.138 times (Knuth, Computer Modern Typefaces)."""
    (path,) = export_results(RESULTS, "latex", tmp_path / "t.tex")
    sizes = {"footnotesize": 8 * 1.063, "scriptsize": 7 * 1.138}
    found = re.findall(
        r"\\(\w+)\\setlength.*?\n\\begin\{tabular\}\{(.*?)\}\n(.*?)\\end\{tabular\}", path.read_text(), re.DOTALL
    )
    assert len(found) > 8
    for size, looks, body in found:
        columns = re.findall(r"p\{58pt|[lr]", looks)
        rows = [re.split(r" (?<!\\)& ", row) for row in re.findall(r"^(.*) \\\\$", body, re.MULTILINE)]
        widths = [58.0 if look.startswith("p") else max(wide(row[n], sizes[size]) for row in rows)
                  for n, look in enumerate(columns)]  # fmt: skip
        assert sum(widths) + 4 * len(widths) <= column, rows[0]


def test_every_letter_of_a_symbol_and_sign_of_a_unit_is_one_that_plain_latex_knows():
    for sign in {*GREEK.values(), *"".join(q.shown_in for q in QUANTITIES.values()), *"−±×°⁻⁶"}:
        reported = typeset(f"x {sign} y")
        assert reported.isascii(), sign
        assert "?" not in reported, sign


def test_the_exported_model_is_the_fitted_muscle(tmp_path):
    """Against the closed form: at rest x = (F_ce - F_L) / K, and the first order motion of B and K."""
    import control  # takes longer than all else that is collected here

    (path,) = export_results(RESULTS, "python-control", tmp_path / "muscle.py")
    names: dict = {}
    exec(compile(path.read_text(), str(path), "exec"), names)
    P, load = 400e3, 157.0
    K, B, F = (samples.truth(symbol, P) for symbol in ("K", "B_c", "F_ce"))
    t = np.linspace(0.0, 3.0, 301)
    params = {"F_c": 0.0, "M": 1.0}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = control.input_output_response(
            names["muscle"], t, [np.full(301, P), np.full(301, load)], [0.0, 0.0], params, solve_ivp_method="LSODA"
        )
    exact = (F - load) / K * (1 - np.exp(-K * t / B))
    late = t > 0.05  # the mass of 1 kg makes the first milliseconds a second order
    assert np.max(np.abs(found.outputs[0] - exact)[late]) < 2e-3 * exact[-1]
    assert found.outputs[0, -1] == pytest.approx((F - load) / 7552.0, rel=1e-3)


def test_the_stated_deviation_is_what_the_model_is_off(tmp_path):
    model = control_model(samples.contraction())
    assert model.deviation is not None
    trace = next(t for t in samples.contraction().traces if t.figure == "overlay")
    off = (
        simulated(trace.columns["t"], trace.columns["pressure"], trace.marks["load"], model.params)
        - trace.columns["model"]
    )
    assert np.max(np.abs(off)) <= model.deviation.largest * 1.01
    (path,) = export_results(RESULTS, "python-control", tmp_path / "m.py")
    assert f"{model.deviation.rms * 1e3:.2g} mm rms off" in path.read_text()
    assert "B_r is not known at 500 kPa" in path.read_text()
    assert "SIMULATED" in path.read_text()


def in_mujoco(text, t, P, load, mass):
    """Contraction at times t [s] under pressures P [Pa] by MuJoCo, from its start."""
    model = mujoco.MjModel.from_xml_string(re.sub(r'mass="[^"]*"', f'mass="{mass:.9g}"', text))
    data = mujoco.MjData(model)
    now = np.arange(round((t[-1] - t[0]) / model.opt.timestep) + 1) * model.opt.timestep
    given = np.interp(t[0] + now + 0.5 * model.opt.timestep, t, P)
    x = np.empty(len(now))
    for i, pressure in enumerate(given):
        x[i] = data.qpos[0]
        data.ctrl[:] = pressure, load
        mujoco.mj_step(model, data)
    return np.interp(t - t[0], now, x)


def test_friction_below_0_is_left_out_since_it_would_drive_the_muscle():
    found = samples.contraction()
    primary = found.estimates[0].method
    below = tuple(
        replace(e, value=-0.06, parts=Parts(0.1)) if (e.symbol, e.method) == ("F_c", primary) else e
        for e in found.estimates
    )
    assert any(e.value == -0.06 for e in below)
    model = control_model(replace(found, estimates=below))
    assert model.params["F_c"] == 0
    assert "Coulomb friction came out below 0 and is left out" in model.notes


def test_the_exported_actuator_does_in_mujoco_what_its_file_says(tmp_path):
    """Along the trials of the analysis, by the solver itself: the stated distance from the fitted muscle, and no more."""
    analysis = samples.contraction()
    (path,) = export_results(RESULTS, "mujoco", tmp_path / "m.xml")
    text, model = path.read_text(), mujoco_model(analysis)
    assert f"is {model.deviation.rms * 1e3:.2g} mm rms off" in text
    assert "SIMULATED" in text
    off = []
    for trace in (t for t in analysis.traces if t.figure == "overlay"):
        t, P, load = trace.columns["t"], trace.columns["pressure"], trace.marks["load"]
        x = in_mujoco(text, t, P, load, load / GRAVITY)
        exported = simulated(t, P, load, model.params | {"M": load / GRAVITY})
        assert np.max(np.abs(x - exported)) < 0.1e-3
        known = np.isfinite(trace.columns["model"]) & (P >= model.params["P"][0])
        off.append((x - trace.columns["model"])[known])
    assert np.sqrt(np.mean(np.concatenate(off) ** 2)) == pytest.approx(model.deviation.rms, rel=0.05)


def test_a_muscle_of_straight_lines_is_exported_without_deviation(tmp_path):
    """At rest x = (F_ce - F_L) / K of the lines; without friction, at a pressure between the tested ones."""
    lines = {"F_ce": (-49.0, 1.08e-3), "K": (5e3, 5e-3), "B_c": (1500.0, 2e-3), "B_r": (1500.0, 2e-3)}
    estimates = tuple(
        samples.estimate(symbol, start + slope * P, "measured-pressure", {"pressure": P})
        for symbol, (start, slope) in lines.items()
        for P in samples.PRESSURES
    )
    analysis = Analysis("contraction-relaxation", ("r--1",), False, estimates)
    (path,) = export_results(Results((analysis,), ()), "mujoco", tmp_path / "m.xml")
    t = np.linspace(0.0, 6.0, 61)
    x = in_mujoco(path.read_text(), t, np.full(61, 333e3), 100.0, 5.0)
    F, K = (start + slope * 333e3 for start, slope in (lines["F_ce"], lines["K"]))
    assert x[-1] == pytest.approx((F - 100.0) / K, rel=1e-4)


def test_what_makes_no_model_is_reported(tmp_path, run):
    with pytest.raises(UsageError, match="no F_ce, K and B_c over pressure"):
        export_results(Results((samples.static_load(),), ()), "python-control", tmp_path / "m.py")
    with pytest.raises(UsageError, match="no analysis"):
        export_results(Results((), ()), "python-control", tmp_path / "m.py")
    with pytest.raises(UsageError, match="format of results"):
        export_run(run, "latex", tmp_path / "x")


@pytest.mark.parametrize("form", [form for form in FORMATS if form not in ("python-control", "mujoco")])
def test_an_analysis_of_nothing_is_exported(form, tmp_path):
    for path in export_results(Results((Analysis("new-kind", (), False),), ()), form, tmp_path / "x"):
        assert path.exists()


def test_the_command_names_what_it_wrote(run, tmp_path):
    def pmabench_export(*words):
        return CliRunner().invoke(main, ["export", *words])

    out = pmabench_export(run.data.path, "--format", "csv", "-o", str(tmp_path / "x"), "--json")
    assert (out.exit_code, json.loads(out.stdout)["format"]) == (0, "csv")
    written = [Path(path) for path in json.loads(out.stdout)["written"]]
    assert all(path.is_file() and path.suffix == ".csv" for path in written)
    (tmp_path / "f").write_text("")
    assert pmabench_export(run.data.path, "--format", "csv", "-o", str(tmp_path / "f")).exit_code == 2
    assert pmabench_export(str(tmp_path), "--format", "mat", "-o", str(tmp_path / "g")).exit_code == 3
