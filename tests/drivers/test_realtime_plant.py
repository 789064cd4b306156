"""The mock in real time as a bench: what it samples, holds and vents; the server's log and state are the judges."""

import itertools
import math
import time
from pathlib import Path

import pytest
from pmabench_drivers.mock.client import MockClient

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.compile import mount
from pmabench.bench.interface import (
    Device,
    Follower,
    Hands,
    Inputs,
    Load,
    Motion,
    Rescue,
    Segment,
    SetPoint,
    Stream,
    Switch,
    Watchdog,
)
from tests.drivers.rig import record
from tests.realtime import CLIENT, eventually, opened, plant_server

pytestmark = pytest.mark.realtime
COUNT = 65.535
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Nothing here is about how long a call may take, and the machine may have much else to do."""
    monkeypatch.setattr("pmabench_drivers.mock.client.PATIENCE", 5.0)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One plant for all tests that leave nothing behind but set-points."""
    with plant_server(tmp_path_factory.mktemp("plant"), record(valve=True, preset="bench", noise=0)) as plant:
        yield plant


@pytest.fixture
def client(shared):
    with opened(shared.device) as client:
        client.write("pressure", 0)
        client.switch("dump_valve", on=True)
        eventually(lambda: shared.state()["pressure"] < 1.0)
        yield client
        client.stop()


def collected(client, seconds):
    """What arrives in the given time: times and columns."""
    blocks, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        blocks.append(client.collect())
        time.sleep(0.02)
    blocks.append(client.collect())
    moments = [t for block in blocks for t in block.time]
    return moments, {name: [v for block in blocks for v in block.columns[name]] for name in blocks[0].columns}


def test_it_has_every_capability(shared):
    for capability in (Device, Stream, SetPoint, Follower, Hands, Switch, Motion, Inputs, Watchdog, Rescue):
        assert isinstance(MockClient(shared.device, RealClock()), capability)


def test_samples_are_500_per_second_of_bench_time(client):
    before = time.monotonic()
    assert client.start(500.0) == 500.0
    after = time.monotonic()
    moments, columns = collected(client, 0.5)
    ended = time.monotonic()
    start = client._clock.start
    assert {b - a for a, b in itertools.pairwise(moments)} == {2_000_000}
    assert before - start - 1e-3 <= moments[0] * 1e-9 <= after - start + 1e-3
    assert moments[-1] * 1e-9 <= ended - start
    assert len(moments) >= 200
    assert all(len(column) == len(moments) for column in columns.values())
    assert set(columns["supply"]) == {690e3}


def test_what_was_not_collected_is_kept_for_the_next_time(client):
    client.start(500.0)
    time.sleep(0.3)
    first = client.collect()
    second = client.collect()
    assert len(first.time) >= 150
    assert list(second.time[:1]) in ([], [first.time[-1] + 2_000_000])
    assert first.host >= first.time[-1]


def test_each_client_has_its_own_bench_time(client, shared):
    other = MockClient(shared.device, RealClock(client._clock.start - 100.0))
    other.open()
    client.start(500.0)
    time.sleep(0.05)
    first = client.collect()
    time.sleep(0.05)
    second = other.collect()
    other.close()
    assert second.time[0] - first.time[-1] == 100_000_000_000 + 2_000_000


def test_a_set_point_reaches_the_plant_and_the_log(client, shared):
    begin = time.monotonic()
    client.write("pressure", 300 * COUNT)
    end = time.monotonic()
    assert client.read_back("pressure") == pytest.approx(300 * COUNT)
    line = shared.commands("write")[-1]
    assert begin <= line["t"] <= end
    assert (line["output"], line["si"], line["role"]) == ("pressure", pytest.approx(300e3), "client")
    eventually(lambda: shared.state()["pressure"] > 299e3)


def test_a_set_point_beyond_the_range_is_taken_as_its_end(client, shared):
    client.write("pressure", 1300 * COUNT)
    line = shared.commands("write")[-1]
    assert (line["si"], line["held"]) == (pytest.approx(1300e3), pytest.approx(1000e3))
    client.write("pressure", -20 * COUNT)
    assert client.read_back("pressure") == 0


def test_a_ramp_is_followed_on_the_bench_time_of_the_client(client, shared):
    clock = client._clock
    start = clock.now() + 0.1
    client.follow("pressure", Segment("ramp", start, 0.0, target=200 * COUNT, rate=1000 * COUNT))
    line = shared.commands("follow")[-1]
    assert line["start"] == pytest.approx(clock.start + start, abs=1e-5)
    assert (line["target"], line["rate"]) == (pytest.approx(200e3), pytest.approx(1e6))
    client.start(500.0)
    moments, columns = collected(client, 0.4)
    client.stop()
    for moment, value in zip(moments, columns["pressure_set"], strict=True):
        expected = min(max(1e6 * (moment * 1e-9 - start), 0.0), 200e3)
        assert value == pytest.approx(expected, abs=20.0)  # 10 us of the ramp, and a count
    assert columns["pressure_set"][-1] == pytest.approx(200e3)


def test_the_dump_valve_empties_the_muscle_whatever_the_regulator_holds(client, shared):
    client.write("pressure", 400 * COUNT)
    eventually(lambda: shared.state()["pressure"] > 399e3)
    client.start(500.0)
    client.switch("dump_valve", on=False)
    assert client.is_on("dump_valve") is False
    moments, columns = collected(client, 0.4)
    pressure = columns["pressure"]
    falling = [k for k, value in enumerate(pressure) if 50e3 < value < 390e3]
    first, last = falling[0], falling[-1]
    lag = (moments[last] - moments[first]) * 1e-9 / math.log(pressure[first] / pressure[last])
    assert lag == pytest.approx(0.1, rel=1e-3)
    assert client.read_back("pressure") == pytest.approx(400 * COUNT)
    assert shared.commands("switch")[-1]["on"] is False


def test_hands_and_digital_input(client, shared):
    client.place(Load(58.86, 8.0))
    assert shared.commands("place")[-1]["mass"] == 8.0
    assert client.level("e_stop") is True
    shared.inject("e_stop")
    assert client.level("e_stop") is False
    shared.clear("e_stop")
    assert client.level("e_stop") is True


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: c.write("presure", 1.0), 'plant: no output "presure"; did you mean "pressure"'),
        (lambda c: c.write("pressure", math.nan), r"plant\.pressure: cannot be commanded to nan"),
        (lambda c: c.rescue("pressure", math.inf), r"plant\.pressure: cannot be commanded to inf"),
        (lambda c: c.follow("pressure", Segment("square", 0.0, 0.0)), "cannot follow"),
        (lambda c: c.follow("pressure", Segment("sine", 0.0, 0.0, amplitude=9e4, frequency=1, cycles=1)), "outside"),
        (lambda c: c.start(0.0), "cannot sample at 0"),
        (lambda c: c.level("door"), 'no digital input "door"'),
        (lambda c: c.switch("vent", on=True), 'no valve "vent"'),
        (lambda c: c.arm_watchdog(0.001), "watchdog takes 0.05 s to 60 s"),
    ],
)
def test_what_cannot_be_is_refused_and_the_link_stays(client, call, message):
    with pytest.raises(DeviceError, match=message):
        call(client)
    assert client.read_back("pressure") == 0


def test_sensors_go_wrong_on_order(client, shared):
    client.start(500.0)
    shared.disturb("pressure", {"offset": 5e3})
    eventually(lambda: any(abs(value - 5e3) < 50 for value in client.collect().columns["pressure"]))
    shared.disturb("pressure", None)
    eventually(lambda: any(abs(value) < 50 for value in client.collect().columns["pressure"]))
    with pytest.raises(DeviceError, match='no fault "brst"; did you mean "burst_at"'):
        shared.inject("brst")


def test_a_burst_on_order_empties_the_muscle(client, shared):
    client.write("pressure", 300 * COUNT)
    eventually(lambda: shared.state()["pressure"] > 290e3)
    shared.inject("burst", after=0.05)
    eventually(lambda: shared.state()["pressure"] < 1e3)
    shared.clear("burst")
    eventually(lambda: shared.state()["pressure"] > 290e3)


# -- the device watchdog -----------------------------------------------------------------------------------------


def test_the_watchdog_vents_when_nobody_speaks(client, shared):
    client.write("pressure", 300 * COUNT)
    eventually(lambda: shared.state()["pressure"] > 299e3)
    assert client.arm_watchdog(1.0) == 1.0
    for _ in range(12):
        time.sleep(0.1)
        last = time.monotonic()
        client.feed_watchdog()
    assert not shared.commands("watchdog")
    eventually(lambda: shared.state()["fired"])  # who only looks does not feed it
    (expiry,) = shared.commands("watchdog")
    assert expiry["t"] - last > 1.0
    assert 1.0 < expiry["silent"] < 5.0
    assert expiry["pressure"] > 299e3
    state = shared.state()
    assert (state["energised"], state["setpoints"]["pressure"]) == (False, 0.0)
    eventually(lambda: shared.state()["pressure"] < 1e3)
    for call in (
        client.feed_watchdog,
        lambda: client.write("pressure", 100 * COUNT),
        lambda: client.switch("dump_valve", on=True),
        lambda: client.follow("pressure", Segment("ramp", 0.0, 0.0, target=COUNT, rate=COUNT)),
    ):
        with pytest.raises(DeviceError, match="watchdog has vented .* arm it again"):
            call()
    client.write("pressure", 0)
    client.switch("dump_valve", on=False)
    client.arm_watchdog(5.0)
    client.write("pressure", 100 * COUNT)
    client.disarm_watchdog()
    assert client.read_back("pressure") == pytest.approx(100 * COUNT)


@pytest.mark.parametrize("fault", ["hang", "dead", "lost"])
def test_a_device_that_hears_nothing_vents_although_the_program_speaks(tmp_path, fault, monkeypatch):
    with plant_server(tmp_path, record(valve=True)) as plant, opened(plant.device) as client:
        client.switch("dump_valve", on=True)
        client.write("pressure", 300 * COUNT)
        client.arm_watchdog(0.6)
        plant.inject(fault)
        monkeypatch.setattr("pmabench_drivers.mock.client.PATIENCE", 0.1)

        def bitten():
            with pytest.raises(DeviceError):
                client.feed_watchdog()
            return plant.commands("watchdog")

        eventually(bitten)
        eventually(lambda: plant.state()["pressure"] < 1e3)


@pytest.mark.parametrize("name", ["mock-realtime", "mock-realtime-actuator"])
def test_the_shipped_benches_lack_no_device_and_are_served(tmp_path, name):
    mounted = mount(ROOT / "fixtures" / "benches" / f"{name}.yaml", ROOT / "fixtures/specimens/mas-20-250-paper0.yaml")
    assert mounted.bench.realtime
    assert [lack for lack in mounted.lacks if not lack.startswith("no session")] == []
    (device,) = mounted.bench.devices
    assert device.driver == CLIENT
    with plant_server(tmp_path, device) as plant, opened(plant.device) as client:
        assert client.arm_watchdog(device.watchdog) == device.watchdog == 1.0
        client.start(500.0)
        time.sleep(0.02)
        assert set(client.collect().columns) == {channel.name for channel in device.channels}
        for output in device.outputs:
            client.write(output.output, output.scale.to_raw(0.0))
            client.halt(output.output)
        for valve in device.valves:
            client.switch(valve.output, on=valve.safe != valve.energised)
        assert [client.level(interlock.input) for interlock in device.interlocks] == [True]


def test_a_drive_stops_where_it_is(tmp_path):
    with plant_server(tmp_path, record(actuator=True)) as plant, opened(plant.device) as client:
        client.follow("displacement", Segment("ramp", client._clock.now(), 0.0, target=40.0, rate=20.0))
        eventually(lambda: client.read_back("displacement") > 2.0)
        client.halt("displacement")
        stopped = client.read_back("displacement")
        assert 2.0 < stopped < 39.0
        time.sleep(0.1)
        assert client.read_back("displacement") == stopped
