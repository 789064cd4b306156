"""What people write about faults, in a file or as a typed line, and what the emulator is told."""

from types import SimpleNamespace

import pytest
from pmabench_drivers.emulator.faults import KINDS
from pmabench_drivers.emulator.faults import Faults as DeviceFaults

from pmabench.base.errors import InvalidFile
from pmabench.cli.emulate import Faults as Written


@pytest.fixture
def written():
    faults = DeviceFaults(KINDS)
    served = SimpleNamespace(
        devices={"regulator": None}, plant_faults=("burst",), kind=lambda _device, fault: faults.known(fault)
    )
    return Written(served, 9.81, 2.0)


def reported(happenings):
    return [(round(item.after, 9), dict(item.wanted)) for item in happenings]


CLEAR = {"device": "regulator", "fault": "clear"}


def fault(kind, value=None, count=-1):
    return {"device": "regulator", "fault": kind, "value": value, "count": count}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("load 6 kg", [(0, {"load": {"force": pytest.approx(58.86), "mass": 8.0}})]),
        ("load 58.86 N after 2 s", [(2, {"load": {"force": 58.86, "mass": pytest.approx(8.0)}})]),
        ("fault regulator silence", [(0, fault("silence"))]),
        ("fault regulator delay 300 ms count 5", [(0, fault("delay", 0.3, 5))]),
        ("fault regulator lost 20 % for 2 s after 1 s", [(1, fault("lost", 0.2)), (3, CLEAR)]),
        ("fault regulator skew -200 ppm", [(0, fault("skew", pytest.approx(-2e-4)))]),
        ("fault regulator truncated 3", [(0, fault("truncated", 3.0))]),
        ("fault regulator noise 0.5", [(0, fault("noise", 0.5))]),
        (
            "plant burst for 500 ms",
            [(0, {"plant": "burst", "over": False}), (0.5, {"plant": "burst", "over": True})],
        ),
        ("plant burst over", [(0, {"plant": "burst", "over": True})]),
    ],
)
def test_typed_lines(written, line, expected):
    assert reported(written.of_line(line)) == expected


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("laod 6 kg", "is not known here"),
        ("load -6 kg", "less than nothing"),
        ("load six", "no force with a unit"),
        ("fault regulator slience", 'did you mean "silence"'),
        ("fault regulator delay 300", "no time with a unit"),
        ("fault regulator delay -1 s", "not below zero"),
        ("fault regulator silence 3", "takes no value"),
        ("fault regulator truncated 3.5", "takes a whole number"),
        ("fault regulator delay 1 s count 0", "whole number from 1"),
        ("fault regulator delay 1 s for 0 s", "after now"),
        ("plant brust", 'did you mean "burst"'),
    ],
)
def test_lines_that_mean_nothing_are_reported(written, line, why):
    with pytest.raises(ValueError, match=why):
        written.of_line(line)


def test_a_file_has_the_same_lines(written, tmp_path):
    path = tmp_path / "plan.txt"
    lines = ("fault regulator lost 20 % for 2 s after 1 s", "plant burst for 500 ms", "load 6 kg")
    path.write_text("# a bad day\n\n" + "  # soon\n".join(lines))
    assert reported(written.of_file(path)) == [item for line in lines for item in reported(written.of_line(line))]


def test_every_problem_of_a_file_comes_with_its_line(written, tmp_path):
    path = tmp_path / "plan.txt"
    wrong = (
        "fault regulator slience",
        "fault regulator delay 20",
        "plant brust",
        "load 6 kg for 2 s",
        "plant burst count 2",
    )
    path.write_text("\n".join(["plant burst", *wrong]))
    with pytest.raises(InvalidFile) as refused:
        written.of_file(path)
    assert [problem.line for problem in refused.value.problems] == [2, 3, 4, 5, 6]
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InvalidFile):
        written.of_file(path)
    with pytest.raises(InvalidFile, match="cannot be read"):
        written.of_file(tmp_path)
