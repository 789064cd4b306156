"""`pmabench model fit`: what a person types, what comes out, and what is told where it cannot be."""

import csv
import io
import json
import math
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path

import pytest

from tests import calls

TABLES = Path(__file__).resolve().parents[2] / "fixtures" / "tables"
STRAND = str(TABLES / "strand-stretch.csv")


call = partial(calls.call, "model", "fit")


def test_a_fit_in_all_its_forms(tmp_path):
    data = json.loads(call("strand-stretch", STRAND, "--json").stdout)
    by = {u["name"]: u for u in data["parameters"]}
    assert list(by) == ["k_p", "k_s"]
    assert by["k_p"]["ci95"][0] < 1.2 < by["k_p"]["ci95"][1]
    assert by["k_s"]["ci95"][0] < 1.05 < by["k_s"]["ci95"][1]
    assert data["domain"]["pressure"] == {"lowest": 1e5, "highest": 5e5, "unit": "Pa"}
    assert (data["rows"], data["degrees_of_freedom"], data["converged"]) == (30, 28, True)
    assert data["inputs"]["braid_angle"]["given"] is False
    rows = list(csv.DictReader(io.StringIO(call("strand-stretch", STRAND, "--csv").stdout)))
    assert [float(row["value"]) for row in rows] == [u["value"] for u in data["parameters"]]
    drawn = tmp_path / "fit.svg"
    text = call("strand-stretch", STRAND, "--plot", str(drawn)).stdout
    assert "residual rms" in text
    assert "28 degrees of freedom" in text
    assert "holds for pressure 100 kPa to 500 kPa, contraction 0 % to 25 %" in text
    assert ET.parse(drawn).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    assert "k_p = 1.2" in drawn.read_text()  # where the data are from


def test_units_of_the_head_count_and_columns_may_have_symbols(tmp_path):
    one = json.loads(call("strand-stretch", STRAND, "--json").stdout)
    lines = (TABLES / "strand-stretch.csv").read_text().splitlines()[2:]
    cells = [[float(cell) for cell in line.split(",")] for line in lines]
    other = tmp_path / "other.csv"
    rows = "".join(f"{F / 1e3},{p * 100},{eps / 100},{i}\n" for i, (p, eps, F) in enumerate(cells))
    other.write_text("F [kN],P_kPa,eps,row\n" + rows)
    result = call("strand-stretch", str(other), "--json")
    two = json.loads(result.stdout)
    assert [u["value"] for u in two["parameters"]] == pytest.approx([u["value"] for u in one["parameters"]], rel=1e-6)
    assert 'column "eps" has no unit: taken as a fraction' in result.stderr
    assert 'not used: column "row"' in result.stderr


def test_a_given_input_is_not_fitted_and_free_names_what_is():
    given = json.loads(call("strand-stretch", STRAND, "--set", "k_s=1.05", "--json").stdout)
    assert [u["name"] for u in given["parameters"]] == ["k_p"]
    assert given["inputs"]["k_s"] == {"given": True, "unit": "1", "value": 1.05}
    asked = json.loads(call("strand-stretch", STRAND, "--free", "k_p, k_s, strand_length", "--json").stdout)
    assert [u["name"] for u in asked["parameters"]] == ["k_p", "k_s", "strand_length"]


def test_rows_are_chosen_by_range(tmp_path):
    table = tmp_path / "t.csv"
    table.write_text("P [bar],K [N/mm]\n" + "".join(f"{p},{10 * p}\n" for p in range(1, 7)))
    options = ("stiffness-polynomial", str(table), "--free", "c_0,c_1", "--set", "order=1", "--json")
    assert json.loads(call(*options).stdout)["rows"] == 6
    low = json.loads(call(*options, "--within", "pressure=1 bar..4 bar").stdout)
    assert low["residual_rms"] < 1e-3
    assert (low["rows"], low["rows_left_out"], low["domain"]["pressure"]["highest"]) == (4, 2, 4e5)


def test_an_analysis_folder_is_a_table(tmp_path):
    (tmp_path / "coefficients.csv").write_text(
        "method,pressure [kPa],K [N/mm],K half width 95 % [N/mm],F_L [N]\n"
        + "".join(f"m1,{p},{p / 50},0.1,\n" for p in range(100, 601, 100))
        + "".join(f"m2,{p},{p / 40},0.1,\n" for p in range(100, 601, 100))
    )
    options = ("--free", "c_0,c_1", "--set", "order=1", "--set", "centre=0 kPa", "--set", "scale=100 kPa", "--json")
    result = call("stiffness-polynomial", str(tmp_path), *options)
    values = {u["name"]: u["value"] for u in json.loads(result.stdout)["parameters"]}
    assert values == pytest.approx({"c_0": 0, "c_1": 2000}, abs=1e-3)
    assert 'method "m1"; there are also: m2' in result.stderr
    # all rows off by the half width at once, and each by itself: hypot(1, 0.93) for c_0 of six rows at 1 to 6
    (c_0, _) = json.loads(result.stdout)["parameters"]
    assert c_0["ci95"][1] - c_0["value"] == pytest.approx(
        100 * math.hypot(1.0, math.sqrt(1 / 6 + 3.5**2 / 17.5)), rel=0.02
    )
    assert 'intervals hold those of column "K half width 95 % [N/mm]"' in result.stderr


@pytest.mark.parametrize(
    ("text", "options", "code", "reported"),
    [
        ("P [bar],force [N]\n1,x\n2,y\n3,4\n", (), 3, 't.csv:2:3  force: "x" is no number'),
        ("P [bar],force [N]\n1,2\n-2,5\n3,4\n", (), 3, "t.csv:3:1  P: -200 kPa is outside the model's domain"),
        (
            "presure [bar],force [N]\n1,2\n",
            (),
            3,
            't.csv:1:1  "presure" is no input or output; did you mean "pressure"?',
        ),
        ("P [bar],a,b\n1,2,3\n", (), 2, "several outputs of tondu-lopez: a, b; choose with --output"),
        ("P [bar],x\n1,2\n", (), 2, "has no column of an output"),
        ("x,force [N]\n1,2\n", (), 2, "has no column of an input"),
        ("P [bar],force [N]\n1,2\n", (), 2, "1 row cannot give 2 values"),
        ("P [bar],force [N]\n1,2\n2,4\n3,6\n4,8\n", ("--free", "P"), 2, "has no such input"),
        ("P [bar],force [N]\n1,2\n2,4\n", ("--set", "pressure=1 bar"), 2, "give one or the other"),
        ("P [bar],force [N]\n1,2\n2,4\n", ("--set", "k=1", "--free", "k"), 2, "it is given with --set"),
        ("P [bar],force [N]\n1,2\n2,4\n", ("--output", "forc"), 2, 'did you mean "force"?'),
        ("P [bar],force [N]\n1,2\n2,4\n", ("--plot", "x.png"), 2, "ends in .svg"),
        ("P [bar],force [N]\n1,2\n2,4\n", ("--within", "pressure=1 bar"), 2, "is no range"),
        ("P [bar],force [N]\n1,2\n2,4\n", ("--start", "k=1.1", "--free", "radius"), 2, "--start k: it is not fitted"),
        ("P [bar],force [N]\n", (), 3, "holds no table"),
    ],
)
def test_what_cannot_be_is_reported_in_a_sentence(tmp_path, text, options, code, reported):
    table = tmp_path / "t.csv"
    table.write_text(text)
    result = call("tondu-lopez", str(table), *options, code=code)
    assert reported in result.stderr
    assert result.stdout == ""


def test_all_bad_cells_come_at_once(tmp_path):
    table = tmp_path / "t.csv"
    table.write_text("P [bar],eps [%],force [N]\n1,x,3\n99,5,\n2,5,z\n")
    shown = json.loads(call("tondu-lopez", str(table), "--json", code=3).stdout)
    assert [(p["line"], p["column"]) for p in shown["problems"]] == [(2, 3), (4, 5)]


def test_a_fit_that_does_not_converge_has_the_exit_code_of_a_failed_verdict(monkeypatch):
    from pmabench.analysis import model_problem

    monkeypatch.setattr(model_problem, "MOST_EVALUATIONS", 1)
    result = call("tondu-lopez", STRAND, code=6)
    assert "fault: the fit did not converge" in result.stdout


def test_what_the_rows_do_not_show_is_left_where_it_is_and_said(tmp_path):
    table = tmp_path / "t.csv"
    table.write_text("P [bar],force [N]\n" + "".join(f"{p},{250 * p + p % 2}\n" for p in range(1, 7)))
    result = call("tondu-lopez", str(table), "--set", "braid_angle=25 deg", "--json")
    assert [u["name"] for u in json.loads(result.stdout)["parameters"]] == ["radius"]
    assert "k changes nothing at these rows: left at 1" in result.stderr


def test_quiet_prints_values_alone():
    lines = call("strand-stretch", STRAND, "-q").stdout.splitlines()
    assert [line.split()[0] for line in lines] == ["k_p", "k_s"]
