"""Offset and drift of a device's clock are found from one-sided arrivals, within the stated uncertainty (R6)."""

import numpy as np
import pytest

from pmabench.store.reader import open_run, read_stream
from pmabench.store.timebase import PRIOR_DRIFT, fit_clock, stamped
from pmabench.store.verify import verify
from tests.reliability.cases import cases
from tests.store.runs import COLUMNS, begin

OFFSET, DRIFT = 0.020, 50e-6
JITTER = {
    "exponential": lambda rng, n: rng.exponential(2e-3, n),
    "uniform": lambda rng, n: rng.uniform(0, 4e-3, n),
    "gamma": lambda rng, n: rng.gamma(2, 1e-3, n),
    "one in fifty late": lambda rng, n: rng.exponential(1e-3, n) + (rng.random(n) < 0.02) * 0.2,
}


def pairs(jitter, seconds, rate=20.0, seed=1, start=1e5):
    """Clock of the device, true time of the run and time of arrival [s]; the device began at `start`."""
    rng = np.random.default_rng(seed)
    device = start + np.arange(int(rate * seconds)) / rate
    true = (device - start) * (1 + DRIFT) + OFFSET
    return device, true, true + JITTER[jitter](rng, len(device))


def ns(seconds):
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


@pytest.mark.parametrize("jitter", JITTER)
def test_fifty_ppm_and_twenty_milliseconds_are_recovered(jitter):
    device, _true, arrived = pairs(jitter, 600)
    clock = fit_clock(ns(device), ns(arrived))
    assert clock.drift == pytest.approx(DRIFT, abs=1e-6)
    at_start = clock.time(ns(device[:1]))[0]
    assert at_start == pytest.approx(OFFSET, abs=1e-4)
    assert clock.uncertainty < 5e-4
    assert clock.how == "host arrivals"


@pytest.mark.parametrize("seconds", [5, 20, 60, 600])
@pytest.mark.parametrize("jitter", JITTER)
def test_the_stated_uncertainty_holds_in_nineteen_of_twenty_cases(jitter, seconds, record_property):
    count = cases(20)
    record_property("cases", count)
    held = 0
    for seed in range(count):
        device, true, arrived = pairs(jitter, seconds, seed=seed)
        clock = fit_clock(ns(device), ns(arrived))
        held += np.abs(clock.time(ns(device)) - true).max() <= clock.uncertainty
    assert held >= 0.95 * count


def test_a_short_stream_is_not_bent_by_its_jitter():
    device, true, arrived = pairs("gamma", 2)
    clock = fit_clock(ns(device), ns(arrived))
    assert clock.drift == 0.0
    assert np.abs(clock.time(ns(device)) - true).max() <= clock.uncertainty
    assert clock.uncertainty > PRIOR_DRIFT * 1.9


def test_a_clock_that_is_far_off_is_believed_even_in_a_short_stream():
    device = np.arange(100) / 20
    clock = fit_clock(ns(device), ns(device * 1.02 + 1 + 1e-4 * np.abs(np.sin(np.arange(100)))))
    assert clock.drift == pytest.approx(0.02, abs=1e-4)


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_arrivals_give_an_offset_only(count):
    clock = fit_clock([10**18 + k for k in range(count)], [5_000_000_000 + k for k in range(count)])
    assert (clock.drift, clock.at) == (0.0, pytest.approx(5.0))


def recorded(parent, events=(), host=True, start=1e9, **manifest):
    """A run whose device began at 1e9 s, is 50 ppm slow, and whose samples came in up to 20 ms late."""
    rng = np.random.default_rng(4)
    writer = begin(parent, **manifest)
    writer.open_stream("gauge", [dict(COLUMNS[2], name="supply")], 50.0)
    for kind, t, data in events:
        writer.event(kind, t, **data)
    for first in range(0, 3000, 25):
        true = (np.arange(first, first + 25) + 1) / 50.0
        device = (true - OFFSET) / (1 + DRIFT) + start
        arrived = int(true[-1] * 1e9 + rng.exponential(4e6)) if host else None
        writer.append("gauge", ns(device), {"supply": true}, np.zeros(25, np.uint16), arrived)
        writer._streams["gauge"].drain()
    return writer


def test_a_recorded_stream_is_on_the_time_of_the_run_open_and_closed(tmp_path):
    writer = recorded(tmp_path)
    live = open_run(writer.folder).clocks["gauge"]
    folder = writer.close("finished")
    assert verify(folder) == []
    run = open_run(folder)
    clock = run.clocks["gauge"]
    assert clock == live, "the arrivals are kept with the Parquet"
    assert clock.drift == pytest.approx(DRIFT, abs=2e-5)
    assert 0 < clock.uncertainty < 2e-3
    frame = read_stream(folder, "gauge")
    reported = (frame["supply"] - COLUMNS[2]["scale"]["offset"]) / COLUMNS[2]["scale"]["slope"]
    assert np.abs(frame["t"] - reported).max() <= clock.uncertainty
    assert run.skew("supply", "force") == clock.uncertainty
    assert run.skew("pressure", "force") == 0.0


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_poll_is_known_to_half_of_what_it_takes_wherever_in_it_the_device_measures(share):
    rng = np.random.default_rng(2)
    asked = np.arange(2000) / 50.0
    took = 0.004 + rng.exponential(1e-3, 2000)
    measured, stamp, answered = asked + share * took, asked + took / 2, asked + took
    clock = stamped(ns(stamp), ns(answered))
    assert (clock.offset, clock.drift) == (0.0, 0.0)
    assert abs(np.mean(clock.time(ns(stamp)) - measured)) <= clock.uncertainty * (1 + 1e-6)
    assert clock.uncertainty == pytest.approx(0.0025, rel=0.02)


def test_the_manifest_says_whose_clock_a_stream_carries(tmp_path):
    reported = {"gauge": {"model": "indicator", "clock": "computer"}}
    folder = recorded(tmp_path, start=0.0, devices=reported).close("finished")
    clock = open_run(folder).clocks["gauge"]
    assert (clock.how, clock.offset, clock.drift) == ("stamped by the computer", 0.0, 0.0)
    assert 0.02 < clock.uncertainty < 0.03, "20 ms late, and 4 ms on average on the way"


def test_a_clock_event_goes_before_the_arrivals(tmp_path):
    reported = ("clock", 0.0, {"stream": "gauge", "offset": -1e9, "drift": 0.0, "uncertainty": 0.5})
    run = open_run(recorded(tmp_path, [reported]).close("finished"))
    assert (run.clocks["gauge"].how, run.clocks["gauge"].uncertainty) == ("clock event", 0.5)


def test_without_arrivals_clocks_are_equal_as_before(tmp_path):
    run = open_run(recorded(tmp_path, host=False).close("finished"))
    assert (run.clocks["gauge"].how, run.clocks["gauge"].offset) == ("stated equal", 0.0)


def test_an_altered_arrival_is_found_like_any_other_number(tmp_path):
    writer = recorded(tmp_path)
    writer._halt()
    path = writer.folder / "streams" / "gauge.arrows"
    raw = bytearray(path.read_bytes())
    at = raw.index(b"host_ns", len(raw) // 2)
    digit = next(k for k in range(at, at + 60) if chr(raw[k]).isdigit())
    raw[digit] = ord("1") if raw[digit] != ord("1") else ord("2")
    path.write_bytes(raw)
    writer._streams["gauge"].file.close()
    writer._streams["daq"].file.close()
    writer._events.close()
    assert any("its crc32 does not fit" in str(finding) for finding in verify(writer.folder))
