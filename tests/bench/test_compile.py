"""Limits are nested, the binding one is named with its place, and a bench that cannot be safe is refused (S1)."""

import json
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.channels import fit_line
from pmabench.bench.compile import mount
from pmabench.bench.interface import CompiledBench

ROOT = Path(__file__).resolve().parents[2]
BENCHES = ROOT / "fixtures" / "benches"
SPECIMEN = ROOT / "fixtures" / "specimens" / "mas-20-250-paper0.yaml"


def bench_with(tmp_path: Path, changes: str) -> Path:
    for part in ("calibrations",):
        target = tmp_path / part
        target.mkdir()
        for file in (BENCHES / part).iterdir():
            (target / file.name).write_text(file.read_text())
    (tmp_path / "base.yaml").write_text((BENCHES / "mock.yaml").read_text())
    path = tmp_path / "bench.yaml"
    path.write_text("include: base.yaml\n" + changes)
    return path


@pytest.mark.parametrize("path", sorted(BENCHES.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_bench_compiles_and_survives_json(path):
    mounted = mount(path, SPECIMEN)
    assert CompiledBench.from_json(mounted.bench.to_json()) == mounted.bench
    for name in ("devices", "trips", "safe_state"):
        cut = {key: value for key, value in json.loads(mounted.bench.to_json()).items() if key != name}
        with pytest.raises(KeyError, match=name):
            CompiledBench.from_json(json.dumps(cut))
    assert mounted.bench.safe_state[-1].do == "confirm"


def test_the_smallest_limit_binds_and_is_named(tmp_path):
    path = bench_with(tmp_path, "")
    assert mount(path, SPECIMEN).bench.outputs[0].high == 600e3
    lower = tmp_path / "specimen.yaml"
    lower.write_text(SPECIMEN.read_text().replace("command: 600 kPa", "command: 420 kPa"))
    output = mount(path, lower).bench.outputs[0]
    assert output.high == 420e3
    line = next(i for i, text in enumerate(lower.read_text().splitlines(), 1) if "420 kPa" in text)
    assert f"specimen.yaml:{line}:" in output.high_from


def test_a_specimen_rated_above_the_bench_is_no_error(tmp_path):
    higher = tmp_path / "specimen.yaml"
    higher.write_text(SPECIMEN.read_text().replace("command: 600 kPa", "command: 690 kPa"))
    assert mount(bench_with(tmp_path, ""), higher).bench.outputs[0].high == 600e3


def test_contraction_trip_is_the_smaller_and_uses_the_mounted_length():
    bench = mount(BENCHES / "mock.yaml", SPECIMEN).bench
    trip = next(trip for trip in bench.trips if trip.channel == "displacement")
    assert trip.high == pytest.approx(0.28 * 0.250)


def test_the_specimens_contraction_limit_is_watched_on_every_bench(tmp_path):
    path = bench_with(tmp_path, "")
    base = tmp_path / "base.yaml"
    base.write_text("\n".join(line for line in base.read_text().splitlines() if "contraction" not in line))
    specimen = tmp_path / "specimen.yaml"
    specimen.write_text(SPECIMEN.read_text().replace("contraction: 28 %", "contraction: 2 %"))
    trip = next(trip for trip in mount(path, specimen).bench.trips if trip.channel == "displacement")
    assert trip.high == pytest.approx(0.005)
    assert "specimen.yaml" in trip.source


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ("limits: {pressure: {command: null}}\n", "has no command limit"),
        ("limits: {pressure: {trip: null}}\n", "has no trip limit"),
        ("limits: {pressure: {trip: 605 kPa}}\n", "must lie at least"),
        ("limits: {pressure: {trip: 960 kPa}}\n", "not inside the channel's range"),
        ("limits: {pressure: {trip: 720 kPa, command: 600 kPa}}\n", "never_above"),
        ("limits: {pressure: {trip: 650}}\n", "no reading with a unit"),
        ("limits: {pressure: {trip: .nan kPa}}\n", "no reading with a unit"),
        ("limits: {pressure: {trip: 20 mm}}\n", "no unit of pressure"),
        ("limits: {pressure: {command_low: 700 kPa}}\n", "nothing may be commanded"),
        ("safe_state: [{confirm: pressure, below: 20 kPa, within: 5 s}]\n", "does not vent"),
        (
            "safe_state: [{set: pressure, to: 0 kPa, within: 1 s}, {set: pressure, to: 900 kPa, within: 1 s}, {confirm: pressure, below: 20 kPa, within: 5 s}]\n",
            "outside the limits of the output",
        ),
        (
            "safe_state: [{set: pressure, to: 0 kPa, within: 1 s}, {set: pressure, to: 90 kPa, within: 1 s}, {confirm: pressure, below: 20 kPa, within: 5 s}]\n",
            "does not vent",
        ),
        ("safe_state: [{set: pressure, to: 0 kPa, within: 1 s}]\n", "does not look"),
        ("outputs: {pressure: {scale: [[0 count, 0 kPa], [65.535 V, 1000 kPa]]}}\n", "in one unit"),
        ("limits: {pressure: {delay: 1 h}}\n", "no protection"),
        ("limits: {pressure: {trip_low: -900 kPa}}\n", "not inside the channel's range"),
        ("safe_state: [{set: presure, to: 0 kPa, within: 5 s}]\n", 'did you mean "pressure"'),
        ("air: {relief_valve: 700 kPa}\n", "not below the specimen's never_above"),
        ("devices: {plant: {driver: mok}}\n", 'did you mean "mock"'),
        ("channels: {pressure: {calibration: MOCK-Q}}\n", "no calibration"),
        ("channels: {pressure: {calibration: MOCK-X}}\n", "measures pressure"),
        ("channels: {pressure: {device: plnt}}\n", 'did you mean "plant"'),
        ("free_end: actuator\n", "belong together"),
    ],
)
def test_a_bench_that_cannot_be_safe_is_refused_with_a_place(tmp_path, changes, says):
    with pytest.raises(InvalidFile, match=says) as caught:
        mount(bench_with(tmp_path, changes), SPECIMEN)
    assert all(problem.line > 0 for problem in caught.value.problems)


def test_problems_of_both_files_come_together(tmp_path):
    specimen = tmp_path / "specimen.yaml"
    specimen.write_text(SPECIMEN.read_text().replace("make:", "maker:"))
    with pytest.raises(InvalidFile) as caught:
        mount(bench_with(tmp_path, "nonsense: 1\n"), specimen)
    assert {Path(problem.path).name for problem in caught.value.problems} == {"bench.yaml", "specimen.yaml"}


def test_what_a_bench_lacks_is_said(tmp_path):
    path = bench_with(tmp_path, "air: {relief_valve: none, dump_valve: none}\nweights: {catch_height: null}\n")
    lacks = " ".join(mount(path, SPECIMEN).lacks)
    for word in ("relief valve", "dump valve", "catch height"):
        assert word in lacks


def test_calibration_points_make_the_least_squares_line():
    scale = fit_line([0.012, 5.003, 9.998], [0.0, 500e3, 1000e3])
    assert scale.slope == pytest.approx(100140.2, rel=1e-4)
    with pytest.raises(ValueError, match="no line"):
        fit_line([1.0, 1.0], [0.0, 2.0])
