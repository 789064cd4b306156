"""What is possible and likely a mistake is said with its place, and refuses nothing; shipped files that belong together
are not doubted."""

from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compilation import _of_other_units
from pmabench.bench.compile import mount
from pmabench.files.document import read_document

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
SPECIMEN = FIXTURES / "specimens" / "mas-20-250-paper0.yaml"


@pytest.mark.parametrize("bench", sorted(path.stem for path in (FIXTURES / "benches").glob("*.yaml")))
def test_what_belongs_together_is_not_doubted(bench):
    found = mount(FIXTURES / "benches" / f"{bench}.yaml", SPECIMEN).doubts
    assert not found or bench == "can", found  # its calibration ends at 60 mm of 90 mm, and it says so


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (
            "[[-50 N, -50 N], [1950 N, 1950 N]]",
            "F-1 has points from -50 N to 1950 N: is it the calibration of this sensor?",
        ),
        ("[[0 N, 0 N], [300 N, 300 N]]", "F-1 covers 0 N to 300 N only: what lies beyond is not calibrated"),
        ("[[-20 N, -20 N], [500 N, 500 N]]", ""),
    ],
)
def test_a_range_of_500_N_over_another_calibration(tmp_path, points, says):
    (tmp_path / "calibrations").mkdir()
    head = "schema: pmabench.calibration/1\nid: F-1\nquantity: force\nreference: a deadweight\ndate: 2026-11-20\n"
    (tmp_path / "calibrations" / "F-1.yaml").write_text(f"{head}points: {points}\nexpanded_uncertainty: 1 N\n")
    for kind in "PX":
        text = (FIXTURES / "benches" / "calibrations" / f"WIRES-{kind}.yaml").read_text()
        (tmp_path / "calibrations" / f"WIRES-{kind}.yaml").write_text(text)
    (tmp_path / "registers").mkdir()
    for path in (FIXTURES / "benches" / "registers").iterdir():
        (tmp_path / "registers" / path.name).write_text(path.read_text())
    text = (FIXTURES / "benches" / "wires.yaml").read_text()
    text = (
        text.replace("[-50 N, 1950 N]", "[-20 N, 500 N]")
        .replace("WIRES-F", "F-1")
        .replace("trip: 1900 N", "trip: 250 N")
    )
    (tmp_path / "bench.yaml").write_text(text)
    found = mount(tmp_path / "bench.yaml", SPECIMEN).doubts
    assert [says in line and "bench.yaml:38:" in line for line in found] == ([True] if says else [])


# -- units, where the file does not get that far --------------------------------------------------------------------

LACKING = """schema: pmabench.bench/1
name: x
channels:
  pressure: {device: a, input: p, range: [0 mm, 1000 kPa], calibration: P}
  force: {device: a, input: f, range: [0 V, 10 V], calibration: F}
  displacement: {device: a, input: x, range: [0 mm, 90 kg], unit: kg}
outputs:
  pressure: {device: a, output: p, scale: [[0 V, 0 kPa], [10 V, 600 N]], resolution: 1 mV}
limits:
  pressure: {command: 900 bananas, trip: 650 kPa}
  contraction: {trip: 28 %}
"""


def problems_of(text, tmp_path):
    (tmp_path / "bench.yaml").write_text(text)
    with pytest.raises(InvalidFile) as refused:
        mount(tmp_path / "bench.yaml", SPECIMEN)
    return {(problem.line, problem.column): problem.message for problem in refused.value.problems}


def test_wrong_units_are_said_together_with_sections_that_are_missing(tmp_path):
    found = problems_of(LACKING, tmp_path)
    units = {place: text for place, text in found.items() if place != (1, 1)}
    assert units == {
        (4, 43): '"mm" is no unit of pressure, for instance "300 kPa"',
        (8, 65): '"N" is no unit of pressure, for instance "300 kPa"',
        (10, 23): 'unknown unit "bananas", for instance "300 kPa"',
    }
    assert found[1, 1].endswith("is missing")


@pytest.mark.parametrize("path", sorted((FIXTURES / "benches").glob("*.yaml")), ids=lambda path: path.stem)
def test_no_unit_of_a_shipped_bench_is_taken_for_a_wrong_one(path):
    assert list(_of_other_units(read_document(path))) == []
