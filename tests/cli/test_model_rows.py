"""`pmabench model rows`: three diameters by hand at each contraction and pressure, against closed forms (paper 3)."""

import json
import math
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main

TABLE = Path(__file__).resolve().parents[2] / "fixtures" / "tables" / "three-diameters.csv"
CALLIPERS = "diameter_1, diameter_2, diameter_3=0.1 mm"
WALL = ("--set", "thickness=1.5 mm")
HEAD = "contraction [%],diameter_1 [mm],diameter_2 [mm],diameter_3 [mm],height_1 [mm],height_2 [mm],height_3 [mm]\n"


def model_rows(path, *options, code=0):
    result = CliRunner().invoke(main, ["model", "rows", "three-cylinder-volume", str(path), *options])
    assert result.exit_code == code, result.output
    return result.output


def columns(path, *options):
    found = json.loads(model_rows(path, *options, "--json"))
    return {column["name"]: column["values"] for column in found["columns"]}, found["notes"]


def muscle_volume(eps):
    """Paper 3: V of a muscle of 20 mm by 200 mm with 25 deg and alpha 2.6 [m3]."""
    angle, size = math.radians(25), math.pi / 4 * 0.02**2 * 0.2
    return size * (1 / math.sin(angle) ** 2 - (1 - eps) ** 2.6 / math.tan(angle) ** 2) * (1 - eps)


def test_volumes_hold_those_of_the_muscle_that_was_measured():
    found, notes = columns(TABLE, *WALL, "--uncertainty", CALLIPERS, "--uncertainty", "thickness=0.05 mm")
    assert [float(text) for text in found["contraction [%]"]] == [0, 10, 20] * 2
    assert [float(text) for text in found["pressure [kPa]"]] == [200] * 3 + [400] * 3
    for text, V, half in zip(found["contraction [%]"], found["volume"], found["volume_half"], strict=True):
        assert abs(V - muscle_volume(float(text) / 100)) < half < 0.02 * V
    assert "height_1, height_2, height_3" in notes[0]


@pytest.mark.parametrize(("what", "share"), [(CALLIPERS, 0.009), ("thickness=0.1 mm", 0.017)])
def test_a_tenth_of_a_millimetre_of_26_mm(tmp_path, what, share):
    """0.9 % of the volume by the diameter, 1.7 % by the wall."""
    path = tmp_path / "one.csv"
    path.write_text(HEAD + "10,26,26,26,40,100,40\n")
    found, _ = columns(path, *WALL, "--uncertainty", what)
    assert found["volume_half"][0] / found["volume"][0] == pytest.approx(share, abs=0.0005)


def test_one_gauge_is_off_for_all_diameters_together(tmp_path):
    path = tmp_path / "one.csv"
    path.write_text(HEAD + "10,24,28,24,40,100,40\n")
    inner, outer = (0.024, 0.028, 0.024), (0.040, 0.100, 0.040)
    by_each = [math.pi / 2 * (d - 0.003) * h * 1e-4 for d, h in zip(inner, outer, strict=True)]
    together, _ = columns(path, *WALL, "--uncertainty", CALLIPERS)
    assert together["volume_half"][0] == pytest.approx(sum(by_each), rel=1e-6)
    options = [part for j in (1, 2, 3) for part in ("--uncertainty", f"diameter_{j}=0.1 mm")]
    apart, _ = columns(path, *WALL, *options)
    assert apart["volume_half"][0] == pytest.approx(math.hypot(*by_each), rel=1e-6)


def test_without_uncertainties_there_are_no_intervals():
    found, notes = columns(TABLE, *WALL)
    assert "volume_half" not in found
    assert notes == []
    assert "volume" in model_rows(TABLE, *WALL)
    assert model_rows(TABLE, *WALL, "--csv").count("\n") == 7


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "no column of thickness"),
        ((*WALL, "--set", "height_1=1 mm"), "has a column of it"),
        ((*WALL, "--uncertainty", "diametre_1=1 mm"), 'did you mean "diameter_1"'),
        ((*WALL, "--uncertainty", "thickness=0 mm"), "must be above zero"),
        ((*WALL, "--uncertainty", "thickness=1 kPa"), "is no unit of length"),
        ((*WALL, "--uncertainty", "height_1, height_1=1 mm"), "given twice"),
        (("--set", "thickness=15 mm"), "thicker than diameter_1 allows"),
    ],
)
def test_what_is_missing_or_wrong_is_said(options, said):
    assert said in " ".join(model_rows(TABLE, *options, code=2).split())


def test_an_empty_cell_is_refused(tmp_path):
    path = tmp_path / "gap.csv"
    path.write_text(HEAD + "10,26,26,26,40,100,40\n20,26,,26,40,100,40\n")
    assert "row 2 of the table has an empty cell" in " ".join(model_rows(path, *WALL, code=2).split())
