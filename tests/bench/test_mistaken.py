"""What is possible and likely a mistake is said with its place, and refuses nothing; shipped files that belong together
are not doubted."""

from pathlib import Path

import pytest

from pmabench.bench.compile import mount

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
