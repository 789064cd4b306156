"""What is possible and likely a mistake is said with its place, and refuses nothing; shipped files that belong together
are not doubted."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.bench.compilation import _of_other_units
from pmabench.bench.compile import mount
from pmabench.bench.remarks import LOOKED_AT, SIMULATED
from pmabench.cli.main import main
from pmabench.files.document import read_document
from pmabench.model.presets import PLANTS, preset

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
SPECIMEN = {
    "mock-contractor": "contractor-30",
    "mock-contractor-15": "contractor-15",
    "mock-contractor-20": "contractor-20",
    "mock-contractor-25": "contractor-25",
    "mock-contractor-40": "contractor-40",
    "mock-daerden": "daerden-20-200",
    "mock-dmsp": "dmsp-40-305",
    "mock-arm": "arm-30",
    "mock-real": "dmsp-20-250-real",
    "mock-realtime": "mas-20-250-paper0",
    "mock-serres2009": "mas-20-250-serres2009",
}
"""Beginning of a bench's name -> its specimen, by docs/simulated-bench.md; of all others `mas-20-250-paper0`."""


def doubts(bench, specimen):
    return mount(FIXTURES / "benches" / f"{bench}.yaml", FIXTURES / "specimens" / f"{specimen}.yaml").doubts


@pytest.mark.parametrize("bench", sorted(path.stem for path in (FIXTURES / "benches").glob("*.yaml")))
def test_what_belongs_together_is_not_doubted(bench):
    begin = max((name for name in SPECIMEN if bench.startswith(name)), key=len, default="")
    found = doubts(bench, SPECIMEN.get(begin, "mas-20-250-paper0"))
    assert not [line for line in found if "the simulated muscle" in line or "of this sensor" in line]
    assert not found or bench == "can", found  # its calibration ends at 60 mm of 90 mm, and it says so


def test_a_specimen_that_is_not_the_simulated_muscle_is_named_with_both_places():
    (line,) = doubts("mock", "contractor-30")
    assert "mock.yaml:11:42  the simulated muscle paper0 is 250 mm long, the specimen 300 mm" in line
    assert "contractor-30.yaml:9:" in line


def test_a_muscle_of_the_same_size_is_reported_by_its_forces():
    """At 300 kPa the published line of the one gives 2.91 * 300 + 44.6 N, that of the other 275 N."""
    (line,) = doubts("mock-serres2009", "mas-20-250-paper0")
    assert "has F_ce 917.6" in line
    assert "the specimen 275 N" in line


@pytest.mark.parametrize(
    ("bench", "specimen", "says"),
    [
        ("mock", "mas-20-250-serres2009", "paper0 is MOCK-P0, the specimen MOCK-SERRES"),
        ("mock", "contractor-25", "paper0 is MOCK-P0, the specimen MOCK-CONTRACTOR-25"),
    ],
)
def test_a_muscle_of_the_same_size_is_reported_by_its_serial_number(bench, specimen, says):
    (line,) = doubts(bench, specimen)
    assert says in line


def test_a_muscle_of_the_same_length_is_reported_by_its_diameter(tmp_path):
    text = (FIXTURES / "specimens" / "mas-20-250-paper0.yaml").read_text(encoding="utf-8")
    (tmp_path / "thin.yaml").write_text(text.replace("inner_diameter: 20 mm", "inner_diameter: 10 mm"))
    (line,) = mount(FIXTURES / "benches" / "mock.yaml", tmp_path / "thin.yaml").doubts
    assert "paper0 is 20 mm wide inside, the specimen 10 mm" in line


def test_the_record_says_it_and_process_repeats_it(tmp_path):
    words = ["--bench", "mock-ideal", "--specimen", "contractor-25", "--out", tmp_path / "runs", "--yes"]
    short = ["sweep.matrix.pressure=[200 kPa, 400 kPa]", "sweep.matrix.load=[6 kg, 16 kg]", "sweep.repeat.count=2"]
    options = [str(word) for word in (*words, *(part for text in short for part in ("--set", text)))]
    assert CliRunner().invoke(main, ["run", "contraction-relaxation", *options]).exit_code == 0
    (run,) = (tmp_path / "runs").iterdir()
    (doubt,) = json.loads((run / "manifest.json").read_text())["doubts"]
    assert "is MOCK-P0, the specimen MOCK-CONTRACTOR-25" in doubt
    reported = json.loads(CliRunner().invoke(main, ["process", "--json", str(run)]).stdout)
    findings = [f for f in reported["analyses"][0]["findings"] if "the specimen MOCK-CONTRACTOR-25" in f["text"]]
    assert [f["level"] for f in findings] == ["doubt"]


@pytest.mark.parametrize("command", ["check", "run"])
def test_check_and_run_say_it(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--bench", "mock", "--specimen", "contractor-30", "--set", "sweep.matrix.pressure=[200 kPa]"]
    short = [
        "--set",
        "sweep.matrix.load=[6 kg]",
        "--set",
        "sweep.repeat.count=1",
        *(["--yes"] if command == "run" else []),
    ]
    reported = CliRunner().invoke(main, [command, "contraction-relaxation", *words, *short])
    assert reported.exit_code == 0, reported.output
    assert "mock.yaml:11:42" in reported.output
    assert "the simulated muscle paper0 is 250 mm long" in reported.output


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
    found = mount(tmp_path / "bench.yaml", FIXTURES / "specimens" / "mas-20-250-paper0.yaml").doubts
    assert [says in line and "bench.yaml:38:" in line for line in found] == ([True] if says else [])


def test_every_simulated_muscle_is_known():
    """Against the plants themselves, which the table must not import."""
    assert set(SIMULATED) == set(PLANTS)
    for name, reported in SIMULATED.items():
        muscle = preset(name).muscle
        assert getattr(muscle, "length", reported.length) == pytest.approx(reported.length)
        assert reported.pull is None or float(muscle.F_ce(LOOKED_AT)) == pytest.approx(reported.pull)


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
        mount(tmp_path / "bench.yaml", FIXTURES / "specimens" / "mas-20-250-paper0.yaml")
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
