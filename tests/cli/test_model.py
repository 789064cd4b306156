"""`pmabench model`: what it prints is what the models give, in units, and what is wrong is told in sentences."""

import csv
import doctest
import io
import json
import re
import shlex
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.model.library import MODELS
from tests import calls

DOCS = Path(__file__).resolve().parents[2] / "docs"


call = partial(calls.call, "model")


def test_list_names_every_model():
    listed = json.loads(call("list", "--json").stdout)["models"]
    assert sorted(row["name"] for row in listed) == sorted(MODELS)
    assert call("list", "-q").stdout.split() == [row["name"] for row in listed]
    assert all(name in call("list").stdout for name in MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_show_of_every_model_agrees_with_what_it_prints(name):
    text = call("show", name).stdout
    assert "DIFFERS" not in text
    assert all(parameter.name in text for parameter in MODELS[name].parameters)
    shown = json.loads(call("show", name, "--json").stdout)
    assert all(reference["agrees"] for reference in shown["references"])


def test_eval_gives_the_force_in_units():
    # pi r0^2 P (a (1 - eps)^2 - b) = pi 1e-4 3e5 (13.7967 0.9^2 - 5.5989) = 525.6 N
    text = call("eval", "tondu-lopez", "--set", "pressure=3 bar", "--set", "contraction=10 %").stdout
    assert "given: pressure 300 kPa, contraction 10 %" in text
    assert "at their reference values: radius 10 mm, braid_angle 25 deg, k 1" in text
    (line,) = (line.split() for line in text.splitlines() if line.startswith("force "))
    assert float(line[2]) == pytest.approx(525.6, abs=0.05)
    assert line[3] == "N"


def test_eval_over_a_range_is_a_table_in_all_forms():
    options = ("dmsp-40-305", "--over", "pressure=100 kPa..600 kPa by 50 kPa")
    data = json.loads(call("eval", *options, "--set", "fit=polynomial", "--json").stdout)
    assert data["inputs"] == {"fit": {"value": "polynomial", "unit": "", "given": True}}
    other = json.loads(call("eval", *options, "--json").stdout)
    assert other["inputs"]["fit"]["given"] is False
    assert other["columns"] == data["columns"]
    columns = {column["name"]: column for column in data["columns"]}
    assert columns["pressure"]["values"] == pytest.approx([1e5 + 0.5e5 * i for i in range(11)])
    assert columns["stiffness"]["unit"] == "N/m"
    assert columns["stiffness"]["values"][-1] == pytest.approx(69590, abs=5)
    rows = list(csv.reader(io.StringIO(call("eval", *options, "--csv").stdout)))
    assert rows[0][:2] == ["pressure [Pa]", "stiffness [N/m]"]
    assert [float(row[1]) for row in rows[1:]] == columns["stiffness"]["values"]
    table = call("eval", *options).stdout
    assert "69.5" in table
    assert "pressure kPa" in table


def test_several_axes_make_every_combination_the_first_outermost():
    options = ("--over", "fce_at=x0, xmax", "--over", "pressure=1 bar, 6 bar", "--json")
    columns = json.loads(call("eval", "dmsp-40-305-contraction", *options).stdout)["columns"]
    table = {column["name"]: column["values"] for column in columns}
    assert table["fce_at"] == ["x0", "x0", "xmax", "xmax"]
    assert table["pressure"] == pytest.approx([1e5, 6e5, 1e5, 6e5])
    assert [round(x * 1e3, 1) for x in table["displacement"]] == [33.0, 76.3, 24.3, 42.4]


def test_everything_that_is_wrong_comes_at_once_with_the_nearest_name():
    result = call(
        "eval", "tondu-lopez", "--set", "presure=3 bar", "--set", "contraction=10", "--set", "k=x",
        "--over", "radius=1 mm..2 mm by 0.3 mm", "--set", "braid_angle=3 kPa", code=2,
    )  # fmt: skip
    for reported in (
        'did you mean "pressure"?', '10 needs a unit', '"x" is no number', "in whole steps", '"kPa" is no unit of angle',
    ):  # fmt: skip
        assert reported in result.stderr.replace('"10" is no ratio with a unit', "10 needs a unit"), reported
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (
            ("dmsp-40-305", "--set", "pressure=0.5 bar"),
            "pressure = 50 kPa is outside its domain, 100 kPa to 600 kPa: fitted on 1",
        ),
        (("dmsp-40-305", "--over", "pressure=0 bar..6 bar by 1 bar"), "pressure = 0 kPa is outside"),
        (("arm-angle", "--set", "load=600 g"), "load = 0.6 kg is outside its domain, 0 kg to 0.5 kg"),
        (("sigmoid-length", "--set", "nominal_length=50 cm"), "15 to 40 cm were measured"),
        (("sigmoid-length", "--set", "exponent=printd"), 'did you mean "printed"?'),
        (("tondu-lopez", "--set", "radius=0 mm"), "radius = 0 mm is outside its domain, above 0 mm"),
        (("step-response", "--set", "load=300 N"), "load = 300 N: a load above F_ce"),
        (
            (
                "polynomial-coefficients",
                "--set",
                "damping_relax_1=-4 N.s/m/kPa",
                "--over",
                "pressure=200 kPa..600 kPa by 50 kPa",
            ),
            "pressure = 300 kPa: the damping would be negative",
        ),
        (("tondu-lopez", "--set", "pressure=3 bar(a)"), "pressures of models are gauge"),
        (("tondu-lopes",), 'did you mean "tondu-lopez"?'),
        (("tondu-lopez", "--over", "k=1..2 by 0.00001"), "at most 20000"),
        (("tondu-lopez", "--over", "k=1..2"), "FIRST..LAST by STEP"),
        (("tondu-lopez", "--set", "k=1", "--set", "k=2"), "given twice"),
        (("tondu-lopez", "--set", "k"), "name=value"),
        (("tondu-lopez", "--csv", "--json"), "not both"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(options, reported):
    result = call("eval", *options, code=2)
    assert reported in (result.stdout if "--json" in options else result.stderr)
    assert result.stdout == "" or "--json" in options


# -- the pages ---------------------------------------------------------------------------------------------------


def test_every_command_of_the_page_works():
    """Those of docs/papers.md are typed by tests/test_pages.py."""
    text = (DOCS / "models.md").read_text()
    found = re.findall(r"`(pmabench model [^`]+)`", text) + re.findall(r"^(pmabench model .*)$", text, re.MULTILINE)
    commands = [shlex.split(each.partition(">")[0], comments=True)[1:] for each in found if "NAME" not in each]
    assert len(commands) >= 4
    for command in commands:
        result = CliRunner().invoke(main, command)
        assert result.exit_code == 0, (command, result.output)
        assert "DIFFERS" not in result.stdout


def test_the_page_of_models_names_each_once_under_its_family():
    rows = re.findall(r"^\| ([a-zA-Z -]+) \| (`.*`) \|$", (DOCS / "models.md").read_text(), re.MULTILINE)
    named = {(family, name) for family, names in rows for name in re.findall(r"`([a-z0-9-]+)`", names)}
    reported = {item for item in named if item[0] in {model.family for model in MODELS.values()}}
    assert reported == {(model.family, model.name) for model in MODELS.values()}


def test_the_example_in_python_gives_what_the_page_says():
    failures, tried = doctest.testfile(str(DOCS / "models.md"), module_relative=False)
    assert tried == 3
    assert failures == 0
