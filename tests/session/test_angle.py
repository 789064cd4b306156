"""The angle of an arm is zeroed where hands hold it straight, and calibrated by reference points."""

from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile, UsageError
from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.session import ensure
from pmabench.session.calibration import Request, check
from pmabench.session.session import SessionFailed

ROOT = Path(__file__).resolve().parents[2]


def arm(folder, session="", **options):
    text = (ROOT / "fixtures" / "benches" / "mock-arm.yaml").read_text()
    (folder / "arm.yaml").write_text(text + session)
    if not (folder / "calibrations").exists():
        (folder / "calibrations").symlink_to(ROOT / "fixtures" / "benches" / "calibrations")
    made = mount(folder / "arm.yaml", ROOT / "fixtures" / "specimens" / "arm-30.yaml")
    devices = tuple(replace(d, options={**d.options, **options}) for d in made.bench.devices)
    return replace(made, bench=replace(made.bench, devices=devices))


ZERO = 'session: {zeros: {angle: {most: 1 deg, at: "the arm straight, no pressure"}}}\n'


def test_an_angle_that_is_far_off_is_refused_and_one_that_is_off_is_zeroed(tmp_path):
    with pytest.raises(SessionFailed, match="the zero of angle is refused: the arm straight"):
        ensure(arm(tmp_path, ZERO, errors={"angle": {"offset": 0.03}}), ConfirmedBeforehand(), tmp_path / "runs")
    before = arm(tmp_path, ZERO, errors={"angle": {"offset": 0.01}})
    after = ensure(before, ConfirmedBeforehand(), tmp_path / "runs")
    old, new = (next(c for c in one.bench.channels if c.name == "angle") for one in (before, after))
    assert old.scale.offset - new.scale.offset == pytest.approx(0.01, abs=5e-4)


def test_where_an_angle_is_zero_is_said(tmp_path):
    with pytest.raises(InvalidFile, match='the zero of the angle needs "at"'):
        arm(tmp_path, "session: {zeros: {angle: {most: 1 deg}}}\n")


def test_an_angle_can_be_calibrated_within_its_range(tmp_path):
    channel, output = check(arm(tmp_path), Request("angle", (0.0, 0.5, 1.0), "protractor", 0.003))
    assert channel is not None
    assert (channel.name, channel.quantity, output) == ("angle", "angle", None)
    with pytest.raises(UsageError, match="171.887 deg is outside the range of angle"):
        check(arm(tmp_path), Request("angle", (0.0, 3.0), "protractor", 0.003))
