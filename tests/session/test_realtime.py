"""A session, a run after it and a calibration in real time: guard process, plant process, virtual time nowhere."""

from dataclasses import replace

import pytest

from pmabench.bench.session import SelfTest, Session, WarmUp, Zero
from pmabench.engine.operator import ConfirmedBeforehand, Nobody
from pmabench.engine.run import run_plan
from pmabench.protocol.plan import Hold, Set
from pmabench.session import ensure
from pmabench.session import session as state
from pmabench.session.calibration import Request, calibrate
from pmabench.session.session import SessionFailed
from pmabench.store.reader import open_run
from tests.engine.benches import mounted, one_trial
from tests.realtime import plant_server

pytestmark = [pytest.mark.realtime, pytest.mark.singly]


@pytest.fixture
def lab(tmp_path):
    """The bench in real time with the shortest session, and its plant."""
    made = mounted("mock-realtime")
    noise = {channel.name: 0.005 * (channel.high - channel.low) for channel in made.bench.channels}
    zeros = {"pressure": Zero(5e3), "force": Zero(5.0), "displacement": Zero(0.5e-3, "on its support", 6.0)}
    session = Session(SelfTest((100e3,), 1.5, 6.0, noise, 0.05, 0.05, 80.0), WarmUp(1.0, 200e3, 1.0), zeros)
    with plant_server(tmp_path, made.bench.devices[0], errors={"pressure": {"offset": 2500.0}}) as plant:
        yield replace(made, bench=replace(made.bench, devices=(plant.device,)), session=session), plant


def test_a_session_and_a_run_with_its_zeros(lab, tmp_path):
    bench, plant = lab
    tables = []
    ready = ensure(bench, ConfirmedBeforehand(), tmp_path / "runs", report=tables.append)
    assert {check.verdict for check in tables[0]} <= {"ok", "not measured", "not checked"}
    assert ready.in_session["zeros"]["pressure"]["value"] == pytest.approx(2500.0, abs=300.0)
    steps = one_trial(Set("c", "pressure", 2e5), Hold("c", 1.5))
    outcome = run_plan(steps, ready, ConfirmedBeforehand(), out=tmp_path / "runs")
    assert (outcome.status, outcome.exit_code) == ("finished", 0), outcome.why
    run = open_run(outcome.folder)
    (check,) = [event.data for event in run.events if event.kind == "zero-check"]
    # a noise of 500 Pa over 0.3 s at 500 Hz leaves 41 Pa, and as much the zero: five standard errors
    assert check["channels"]["pressure"]["drift"] == pytest.approx(0.0, abs=300.0)
    assert run.trials[0].channels["pressure"][-50:].mean() == pytest.approx(2e5, abs=500.0)
    assert state.out_of_date(state.kept(bench.bench.name), bench, state.utc_now()) == ""
    assert plant.state()["pressure"] < 20e3


def test_a_wrong_wire_ends_the_session_vented(lab, tmp_path):
    bench, plant = lab
    plant.disturb("pressure", {"reads": "force"})
    plant.disturb("force", {"reads": "pressure"})
    with pytest.raises(SessionFailed, match="the plugs of pressure and force, swapped"):
        ensure(bench, ConfirmedBeforehand(), tmp_path / "runs")
    assert plant.state()["pressure"] < 20e3
    assert not [line for line in plant.commands("write") if line["si"] > 0]  # seen before the proof test
    assert state.kept(bench.bench.name) == {}


def test_a_calibration_finds_the_offset(lab, tmp_path):
    bench, _ = lab
    request = Request("pressure", (0.0, 300e3), "gauge", 100.0, cycles=1, seconds=0.5)
    done = calibrate(bench, request, Nobody(), lambda text, nominal, wait: wait() or nominal, tmp_path / "runs")
    assert done.outcome.exit_code == 0, done.outcome.why
    old = next(c for c in bench.bench.channels if c.name == "pressure").scale
    assert done.fit.scale.to_si(old.to_raw(100e3 + 2500.0)) == pytest.approx(100e3, abs=done.fit.expanded)
