"""Jogging: nothing beyond the set-up pressure, whatever keys come; recorded; vented at the end."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.base.errors import UsageError
from pmabench.engine.operator import Nobody
from pmabench.session.guided import jog
from pmabench.store.reader import open_run
from tests.engine.benches import mounted


def pressed(bench, keys, out=None):
    """Press one key after another, then `v`; everything that was shown."""
    left, seen = [*keys, "v"], []
    outcome = jog(
        mounted(bench), Nobody(), out, lambda: [left.pop(0)] if left else [], lambda *shown: seen.append(shown)
    )
    return outcome, seen


@settings(max_examples=25)
@given(st.text("+-][><0zxv", max_size=30))
@pytest.mark.parametrize("bench", ["mock", "mock-actuator"])
def test_no_key_leads_out_of_the_limits(bench, keys):
    outcome, _ = pressed(bench, keys)
    assert outcome.exit_code == 0
    assert outcome.vent.confirmed
    limits = {"pressure": (0.0, 100e3), "displacement": (0.0, 50e-3)}
    for kind, _, data in outcome.events:
        if kind == "command":
            low, high = limits[data["output"]]
            assert low <= data["value"] <= high


def test_keys_do_what_the_line_says(tmp_path):
    """Steps of 5 kPa: up twice, one step size more (10 kPa), up, down to zero."""
    outcome, seen = pressed("mock", "++>+0", tmp_path)
    run = open_run(outcome.folder)
    assert (run.kind, run.status) == ("setup", "finished")
    values = [e.data["value"] for e in run.events if e.kind == "command" and e.data["phase"] == "jog"]
    assert values == [5e3, 10e3, 20e3, 0.0]
    assert seen[3][1].settings() == "commanded pressure 0 kPa (up to 100 kPa)"  # the same object, at its end
    assert [reported for _, _, reported in seen][2] == ["step 10 kPa"]


def test_the_limit_is_reported_where_it_ends(tmp_path):
    _, seen = pressed("mock", ">>>+++")
    assert seen[-2][2] == ["pressure 100 kPa: its limit here"]


def test_the_actuator_goes_there_at_a_low_speed():
    outcome, _ = pressed("mock-actuator", ">]]")
    ramps = [data for kind, _, data in outcome.events if kind == "command" and data["output"] == "displacement"]
    assert [ramp["value"] for ramp in ramps] == pytest.approx([1e-3, 2e-3])
    assert all(ramp["type"] == "ramp" and ramp["rate"] == pytest.approx(0.025) for ramp in ramps)


def test_a_bench_without_outputs_is_not_moved():
    from dataclasses import replace

    bench = mounted("mock")
    devices = tuple(replace(device, outputs=()) for device in bench.bench.devices)
    with pytest.raises(UsageError, match="no output to move"):
        jog(replace(bench, bench=replace(bench.bench, devices=devices)), Nobody(), None, list, print)
