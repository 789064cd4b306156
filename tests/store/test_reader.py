"""A run comes back as what was commanded, measured and found, in SI on one time base."""

import numpy as np
import pyarrow as pa
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.files.quantity import parse_quantity
from pmabench.store.reader import open_run, read_stream
from pmabench.store.verify import verify
from pmabench.store.writer import RunWriter
from tests.store.runs import COLUMNS, begin, block, closed, die, record, unclosed


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return open_run(closed(tmp_path_factory.mktemp("reader"), specimen="MAS-20"))


def test_the_run_says_what_it_is(run):
    assert (run.id, run.kind, run.status, run.simulated, run.rate) == (
        "run",
        "contraction-relaxation",
        "finished",
        True,
        500.0,
    )
    assert run.plan["schema"] == "pmabench.plan/1"
    assert run.manifest["end"] == {"vent": {"result": "confirmed"}}
    assert [event.seq for event in run.events] == list(range(12))
    assert run.events[-1].kind == "end"


def test_channels_carry_scale_range_and_calibration(run):
    pressure = run.channels["pressure"]
    assert (pressure.unit, pressure.slope, pressure.offset, pressure.low, pressure.high) == (
        "Pa",
        0.25,
        -500.0,
        0.0,
        1e6,
    )
    assert (pressure.calibration, pressure.offset_uncertainty, pressure.gain_uncertainty) == ("P-0231", 1500.0, 0.001)
    assert pressure.sensor_lag == 0.002
    assert run.channels["displacement"].unit == "m"


def test_samples_as_recorded_are_in_memory_a_part_at_a_time(tmp_path):
    rows = 400_000
    folder, before = closed(tmp_path, rows=rows), pa.default_memory_pool()
    pool = pa.proxy_memory_pool(before)
    pa.set_memory_pool(pool)
    try:
        run = open_run(folder)
    finally:
        pa.set_memory_pool(before)
    time_ns, raw, flags = block(0, rows)
    recorded = sum(column.nbytes for column in (time_ns, *raw.values(), flags))
    assert 0 < pool.max_memory() < 0.6 * recorded
    for name, slope, offset in (("pressure", 0.25, -500.0), ("force", 200.0, 3.0)):
        read = np.concatenate([trial.channels[name] for trial in run.trials])
        assert np.array_equal(read, raw[name] * slope + offset), "no sample is lost where two parts meet"


def test_trials_hold_their_samples_in_si(run):
    first, second = run.trials
    assert [trial.index for trial in run.trials] == [0, 1]
    assert (first.status, second.status) == ("finished", "failed")
    assert (first.repeat, first.reference, second.repeat, second.reference) == (0, True, 1, False)
    assert first.point == {"load": 58.8, "pressure": 3e5}
    for number, trial in enumerate(run.trials):
        time_ns, raw, flags = block(number * 1000, 1000)
        assert trial.t.tolist() == [k / 500 for k in range(number * 1000, number * 1000 + 1000)]
        assert np.allclose(trial.t, time_ns * 1e-9, atol=0, rtol=1e-15)
        assert trial.channels["pressure"].tolist() == (raw["pressure"] * 0.25 - 500.0).tolist()
        assert trial.channels["displacement"].tolist() == (raw["displacement"] * -1e-6 + 0.05).tolist()
        assert trial.channels["force"].tolist() == (raw["force"] * 200.0 + 3.0).tolist()
        assert trial.flags.tolist() == flags.tolist()
        assert trial.usable.sum() == 980


def test_commands_and_findings_belong_to_their_trial(run):
    second = run.trials[1]
    step, ramp = second.commands
    assert (step.kind, step.output, step.value, step.before, step.phase) == ("set", "pressure", 3e5, 0.0, "contract")
    assert step.data == {"sent": 3.0001e5}
    assert (ramp.kind, ramp.data) == ("ramp", {"rate": 5e4})
    assert (step.t, ramp.t) == (2.1, 2.2)
    assert second.found == {"lift": {"found": True, "pressure": 1.5e5}}


def test_a_command_before_its_trial_begins_belongs_to_it_and_a_repeated_trial_is_another(tmp_path):
    writer = begin(tmp_path)
    command = {"output": "pressure", "type": "set", "before": 0.0, "phase": "p", "trial": 0}
    writer.event("command", 0.0, value=1.0, **command)
    for start in (0.1, 0.5):
        writer.event("trial-begin", start, trial=0, point={}, repeat=0, reference=False)
        writer.event("command", start, value=start, **command)
        writer.event("trial-end", start + 0.2, trial=0, status="failed")
    writer.append("daq", *block(0, 500))
    trials = open_run(writer.close("failed")).trials
    assert [[command.value for command in trial.commands] for trial in trials] == [[1.0, 0.1], [0.5]]
    assert [(trial.t[0], trial.t[-1]) for trial in trials] == [(0.1, 0.3), (0.5, 0.7)]


def test_pressures_that_were_written_in_bar_and_in_kPa_are_one_operating_point(tmp_path):
    writer = begin(tmp_path)
    for trial, pressure in enumerate((parse_quantity("2.3 bar", "pressure"), 230e3)):
        writer.event("trial-begin", trial * 0.2, trial=trial, point={"pressure": pressure}, repeat=0, reference=False)
        writer.event("trial-end", trial * 0.2 + 0.2, trial=trial, status="finished")
    writer.append("daq", *block(0, 301))
    assert [trial.point for trial in open_run(writer.close("finished")).trials] == 2 * [{"pressure": 230e3}]


def test_a_sample_where_one_trial_ends_and_the_next_begins_is_not_counted_twice(tmp_path):
    writer = begin(tmp_path)
    for trial in range(3):
        writer.event("trial-begin", trial * 0.2, trial=trial, point={}, repeat=0, reference=False)
        writer.event("trial-end", trial * 0.2 + 0.2, trial=trial, status="finished")
    writer.append("daq", *block(0, 301))
    trials = open_run(writer.close("finished")).trials
    assert np.concatenate([trial.t for trial in trials]).tolist() == [k / 500 for k in range(301)]


def test_what_is_not_a_number_is_null_in_the_record(tmp_path):
    writer = begin(tmp_path)
    writer.event("found", 0.0, phase="x", result={"K_u": float("nan"), "list": np.array([1.0, np.inf])}, trial=None)
    assert open_run(writer.close("finished")).events[0].data["result"] == {"K_u": None, "list": [1.0, None]}


def test_a_running_run_can_be_read(tmp_path):
    writer = begin(tmp_path)
    record(writer)
    run = open_run(writer.folder)
    assert run.status == "running"
    assert [len(trial.t) for trial in run.trials] == [1000, 1000]
    writer.close("finished")


def test_a_run_before_its_first_sample_can_be_read(tmp_path):
    writer = begin(tmp_path)
    run = open_run(writer.folder)
    assert (run.trials, run.events, set(run.channels)) == ((), (), {"pressure", "displacement", "force"})
    writer.close("aborted", "at once")
    assert verify(writer.folder) == []
    assert open_run(writer.folder).trials == ()


def test_a_trial_under_way_when_the_writer_died_is_interrupted(tmp_path):
    writer = begin(tmp_path)
    writer.event("trial-begin", 0.0, trial=3, point={}, repeat=0, reference=False)
    writer.append("daq", *block(0, 70))
    die(writer)
    (trial,) = open_run(writer.folder).trials
    assert (trial.status, trial.index, len(trial.t)) == ("interrupted", 3, 70)


def test_streams_with_the_same_time_stamps_are_joined_with_the_flags_of_both(tmp_path):
    writer = begin(tmp_path)
    writer.open_stream("gauge", [dict(COLUMNS[2], name="supply")], 500.0)
    record(writer)
    time_ns, raw, flags = block(0, 2000)
    flags[1500] = 32
    writer.append("gauge", time_ns, {"supply": raw["force"]}, flags)
    run = open_run(writer.close("finished"))
    trial = run.trials[1]
    assert set(trial.channels) == {"pressure", "displacement", "force", "supply"}
    assert trial.channels["supply"].tolist() == trial.channels["force"].tolist()
    assert trial.flags.tolist() == flags[1000:].tolist()
    assert (run.interpolated, run.skew("supply", "force")) == ({}, 0.0)


def test_a_clock_event_turns_device_time_into_time_of_the_run(tmp_path):
    writer = begin(tmp_path)
    time_ns, raw, flags = block(0, 3)
    writer.append("daq", time_ns + 10**15, raw, flags)
    writer.event("clock", 1.0, stream="daq", offset=-1e6 * (1 + 5e-5) + 2.0, drift=5e-5, uncertainty=1e-4)
    folder = writer.close("finished")
    assert np.allclose(read_stream(folder)["t"], 2.0 + np.arange(3) * 0.002 * (1 + 5e-5), atol=1e-9)
    clock = open_run(folder).clocks["daq"]
    assert (clock.how, clock.drift, clock.uncertainty) == ("clock event", 5e-5, 1e-4)


def test_streams_are_tables_in_si_or_raw(tmp_path):
    folder = unclosed(tmp_path)
    frame = read_stream(folder, "daq")
    assert frame.columns.tolist() == ["t", "pressure", "displacement", "force", "flags"]
    assert frame.attrs["units"] == {"t": "s", "pressure": "Pa", "displacement": "m", "force": "N"}
    assert read_stream(folder, raw=True).attrs["units"]["pressure"] == "count"
    with pytest.raises(InvalidFile, match='has no stream "dac"; it has: daq'):
        read_stream(folder, "dac")


def test_an_import_keeps_irregular_time_flags_and_the_values_of_the_file(tmp_path):
    stamps = np.array([0, 2, 4, 104, 100, 110], dtype=np.int64) * 1_000_000
    flags = np.array([0, 0, 128, 1, 16, 32], dtype=np.uint16)
    column = {"name": "pressure", "quantity": "pressure", "raw_type": "float64", "raw_unit": "bar"}
    column |= {"scale": {"slope": 1e5, "offset": 0.0}, "low": None, "high": None}
    writer = RunWriter.create(tmp_path, "imported", {"imported": {"file": "old.csv", "sha256": "0" * 64}}, {})
    writer.open_stream("file", [column], 0.0)
    writer.event("trial-begin", 0.0, trial=0, point={"pressure": 3e5}, repeat=0, reference=False)
    writer.append("file", stamps, {"pressure": np.array([1.5, np.nan, -0.0, 2.5, 3.5, 1e-320])}, flags)
    writer.event("trial-end", 0.12, trial=0, status="finished")
    folder = writer.close("finished")
    assert verify(folder) == []
    run = open_run(folder)
    assert run.manifest["imported"]["file"] == "old.csv"
    (trial,) = run.trials
    assert trial.t.tolist() == [0.0, 0.002, 0.004, 0.104, 0.1, 0.11]
    assert trial.channels["pressure"].tolist()[3:5] == [2.5e5, 3.5e5]
    assert np.isnan(trial.channels["pressure"][1])
    assert trial.flags.tolist() == flags.tolist()
    assert run.channels["pressure"].low == -np.inf
