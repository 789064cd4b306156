"""The start check names each fault of the bench by the wire to look at; nothing runs then."""

import numpy as np
import pytest

from pmabench.analysis.verdict.life import leak_of
from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.session import ensure
from pmabench.session import session as state
from pmabench.session.self_test import run_self_test
from pmabench.session.session import SessionFailed
from pmabench.store.reader import open_run
from tests.engine.benches import ROOT, SPECIMEN, mounted

FAULTS = {
    "pressure and force swapped": (
        {"errors": {"pressure": {"reads": "force"}, "force": {"reads": "pressure"}}},
        "undecided between the pressure (plant.pressure) and the plugs of pressure and force, swapped",
        0.0,  # nothing is pressurised by a wrong pressure; what hangs on the cell is not known yet
    ),
    "force and displacement swapped": (
        {"errors": {"force": {"reads": "displacement"}, "displacement": {"reads": "force"}}},
        "plugs of force and displacement are swapped (plant.force and plant.displacement)",
        100e3,
    ),
    "pressure and displacement swapped": (
        {"errors": {"pressure": {"reads": "displacement"}, "displacement": {"reads": "pressure"}}},
        "and the plugs of pressure and displacement, swapped",
        0.0,
    ),
    "sign of pressure": ({"errors": {"pressure": {"factor": -1}}}, "sign of the pressure (plant.pressure)", 25e3),
    "sign of force": ({"errors": {"force": {"factor": -1}}}, "sign of the force (plant.force) is wrong", 100e3),
    "sign of displacement": ({"errors": {"displacement": {"factor": -1}}}, "sign of the displacement", 100e3),
    "dead regulator": ({"faults": {"regulator_stuck_at": 0.0}}, "regulator that does not follow", 25e3),
    "leak": ({"leak": 1.0}, "a leak, too little supply", 75e3),
    "slow regulator": ({"regulator_lag": 1.5}, "pressure comes to rest", 25e3),
    "noise": ({"noise": 20}, "shield and ground of the wire to plant.pressure", 0.0),
    "supply low": ({"supply": 500e3}, "look at the supply, its valve", 0.0),
    "cut wire of the force": (
        {"errors": {"force": {"end": "low"}}},
        "look at the wire of the force (plant.force)",
        100e3,
    ),
    "dead dump valve": ({"faults": {"dump_stuck_at": 0.0}}, "the valve dump_valve (plant.dump_valve)", 25e3),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_and_ends_the_session_where_it_is_seen(tmp_path, name):
    options, said, highest = FAULTS[name]
    with pytest.raises(SessionFailed) as refused:
        ensure(mounted("mock-session", **options), ConfirmedBeforehand(), tmp_path / "runs")
    assert said in str(refused.value)
    run = open_run(refused.value.outcome.folder)
    commanded = [e.data["value"] for e in run.events if e.kind == "command" and e.data["output"] == "pressure"]
    assert max(commanded, default=0.0) == pytest.approx(highest)
    checks = next(e.data["checks"] for e in run.events if e.kind == "self-test")
    failed = [check for check in checks if check["verdict"] == "failed"]
    assert failed
    assert state.kept(mounted("mock-session").bench.name) == {}


def test_a_good_bench_passes_with_every_seed(tmp_path):
    for seed in range(5):
        ensure(mounted("mock-session", seed=seed), ConfirmedBeforehand(), tmp_path / "runs", anew=True)


def test_the_free_end_driven(tmp_path):
    """The actuator holds the free end: the force answers, nothing moves, and the delay can be told."""
    from dataclasses import replace

    from pmabench.bench.session import SelfTest, Session, Zero

    bench = mounted("mock-actuator")
    noise = {channel.name: 0.005 * (channel.high - channel.low) for channel in bench.bench.channels}
    test = SelfTest((50e3, 100e3), 1.5, None, noise, 0.05, 0.02, 80.0)
    bench = replace(bench, session=Session(test, None, {"pressure": Zero(5e3), "force": Zero(5.0)}))
    tables = []
    ready = ensure(bench, ConfirmedBeforehand(), tmp_path / "runs", report=tables.append)
    table = {check.name: check for check in tables[0]}
    assert table["force under pressure"].value == "rises by 59 N at 100 kPa"  # 1.08 x 100 - 49
    assert abs(float(table["time of force against pressure"].value.split()[0])) < 5.0
    assert set(ready.in_session["zeros"]) == {"pressure", "force"}


@pytest.mark.parametrize(("leak", "said"), [(0.0, "ok"), (1e-4, "ok"), (0.01, "failed")])
def test_leak_by_pressure_decay_behind_an_isolation_valve(tmp_path, leak, said):
    """P' = -leak P: at 100 kPa and 1 % per second 60 kPa per minute at the beginning; 5 kPa per minute are allowed."""
    (tmp_path / "benches").symlink_to(ROOT / "fixtures" / "benches")
    path = tmp_path / "isolated.yaml"
    path.write_text(
        (ROOT / "fixtures" / "benches" / "mock-session.yaml").read_text().replace(": mock.yaml", ": benches/mock.yaml")
        + f"""
devices: {{plant: {{options: {{leak: {leak}}}}}}}
air: {{isolation_valve: isolation_valve}}
outputs: {{isolation_valve: {{device: plant, output: isolation_valve, energised: open}}}}
safe_state:
  - {{set: pressure, to: 0 kPa, within: 200 ms}}
  - {{open: dump_valve, within: 200 ms}}
  - {{close: isolation_valve, within: 200 ms}}
  - {{confirm: pressure, below: 20 kPa, within: 5 s}}
"""
    )
    tables = []
    outcome = run_self_test(mount(path, SPECIMEN), ConfirmedBeforehand(), tmp_path / "runs", report=tables.append)
    check = next(check for check in tables[0] if check.name == "leak")
    assert check.verdict == said
    top = 100.0 / (1 + leak * 0.0955)  # what a regulator of that lag holds against the leak
    mean = top * np.exp(-leak * 1.0) * np.exp(-leak * 5.0)
    assert float(check.value.split()[2]) == pytest.approx(60 * leak * mean, abs=0.4, rel=0.02)
    assert outcome.vent.confirmed
    assert (outcome.exit_code == 6) == (said == "failed")
    events = open_run(outcome.folder).events
    reported = next(e.data["leak"] for e in events if e.kind == "self-test")
    assert reported["pressure"] == 100e3
    assert reported["falls"] == pytest.approx(1e3 * leak * mean, abs=6.0, rel=0.02)
    assert abs(reported["falls"] - 1e3 * leak * mean) < 5 * reported["half_width"] + 0.02 * 1e3 * leak * mean
    assert reported["half_width"] == pytest.approx(1.96 * 0.78e3 * (12 / 5000) ** 0.5 / 10, rel=0.1)  # noise of 780 Pa
    followed = leak_of("r", events, simulated=True).estimates[0]
    assert (followed.value, followed.at) == (reported["falls"], {"pressure": 100e3})
