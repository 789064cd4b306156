"""What a bench file says about safety arrives in the records as it was meant; what cannot be is refused with a place."""

import datetime
import re
import shutil

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.bench.interface import CompiledBench, InterlockRecord, ProofTest, SafeAction, TripRecord, ValveRecord
from tests.bench.benches import BENCHES, SPECIMEN, rig, specimen


def refused(bench, muscle=SPECIMEN) -> InvalidFile:
    with pytest.raises(InvalidFile) as caught:
        mount(bench, muscle)
    assert all(problem.line > 0 for problem in caught.value.problems), caught.value
    return caught.value


def test_every_key_arrives_in_the_records(tmp_path):
    path = rig(tmp_path)
    mounted = mount(path, SPECIMEN)
    bench = mounted.bench
    (daq,) = bench.devices
    assert daq.valves == (ValveRecord("dump_valve", "daq", "dump_valve", "closed", "open"),)
    assert daq.interlocks == (InterlockRecord("e-stop", "daq", "e_stop", "high"),)
    assert daq.watchdog == 1.0
    assert bench.safe_state == (
        SafeAction("ramp", "pressure", 0.0, 2.0, 500e3),
        SafeAction("hold", "", 0.0, 0.1),
        SafeAction("set", "pressure", 0.0, 0.2),
        SafeAction("open", "dump_valve", 0.0, 0.2),
        SafeAction("confirm", "pressure", 20e3, 5.0),
    )
    assert bench.proof == ProofTest(50e3, 20e3, 2.0, 5.0)
    assert (bench.stop_rate, bench.setup_pressure, bench.path) == (500e3, 80e3, str(path.resolve()))
    assert CompiledBench.from_json(bench.to_json()) == bench
    assert mounted.lacks == ()


def test_the_watch_list_arrives_in_the_records(tmp_path):
    path = rig(tmp_path)
    trips = [trip for trip in mount(path, SPECIMEN).bench.trips if trip.kind != "range"]
    line = 1 + path.read_text().splitlines().index("watch:")

    def reported(number, channel, kind, action, *, low=None, high=None, delay=0.0, window=0.0):
        trip = trips[number - 1]
        assert re.search(rf"rig\.yaml:{line + number}:5$", trip.source)
        assert trip == TripRecord(channel, low, high, delay, action, trip.source, kind, window)

    reported(1, "pressure", "stale", "vent", delay=0.1)
    reported(2, "pressure", "frozen", "stop", delay=5.0)
    reported(3, "force", "off-range", "vent")
    reported(4, "pressure", "rate", "vent", high=5e6, delay=0.02)
    reported(5, "force", "rate", "warn", high=5e4)
    reported(6, "pressure", "following", "hold", high=60e3, delay=2.0)
    reported(7, "pressure", "burst", "vent", high=60e3, window=0.05)
    reported(8, "force", "slack", "warn", low=1.0, delay=0.1)
    assert len(trips) == 8


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("{stale: pressure, action: vent}", '"stale" needs "for"'),
        ("{stale: pressure, for: 0 s, action: vent}", "above zero"),
        ("{stale: pressure, for: 100 ms}", '"action" is missing'),
        ("{stale: presure, for: 1 s, action: vent}", 'did you mean "pressure"'),
        ("{stale: pressure, frozen: pressure, for: 1 s, action: vent}", '"stale" and "frozen"'),
        ("{for: 1 s, action: vent}", "there is none"),
        ("{stale: pressure, for: 1 s, more_than: 1 kPa, action: vent}", 'does not belong to "stale"'),
        ("{stale: pressure, for: 1 s, action: explode}", "is not known here"),
        ("{rate: pressure, faster_than: 60 kPa, action: vent}", "no unit of pressure rate"),
        ("{rate: force, faster_than: 60 kPa/s, action: vent}", "no unit of force rate"),
        ("{following: force, more_than: 60 N, for: 1 s, action: hold}", 'nothing commands "force"'),
        ("{burst: pressure, falls: 1100 kPa, within: 50 ms, action: vent}", "never be seen"),
        ("{slack: force, below: -60 N, for: 50 ms, action: warn}", "never be seen"),
        ("{stale: pressure, for: 1 h, action: vent}", "3600 s is outside 0 s to 60 s"),
        ("{burst: pressure, falls: 100 kPa, within: 1 h, action: vent}", "3600 s is outside 0 s to 60 s"),
        ("{stal: pressure, for: 1 s, action: vent}", 'did you mean "stale"'),
    ],
)
def test_a_watch_that_makes_no_sense_is_refused(tmp_path, entry, says):
    assert says in str(refused(rig(tmp_path, f"watch:\n  - {entry}\n")))


END = "  - {confirm: pressure, below: 20 kPa, within: 5 s}\n"
VENT = "  - {set: pressure, to: 0 kPa, within: 1 s}\n"
DUMP = "  - {open: dump_valve, within: 1 s}\n"


@pytest.mark.parametrize(
    ("actions", "says"),
    [
        (VENT + END, "does not open the dump valve"),
        (VENT + DUMP + "  - {close: dump_valve, within: 1 s}\n" + END, "does not open the dump valve"),
        (VENT + "  - {open: dumpvalve, within: 1 s}\n" + END, 'did you mean "dump_valve"'),
        (DUMP + END, "does not vent"),
        (DUMP + END + VENT, "looks before the vent"),
        ("  - {set: pressure, to: 1 kPa, within: 1 s}\n" + DUMP + END, "does not vent"),
        ("  - {set: pressure, to: 0 kPa, within: 1 h}\n" + DUMP + END, "3600 s is outside 0 s to 60 s"),
        (VENT + DUMP + END.replace("5 s", "1 h"), "3600 s is outside 0 s to 60 s"),
        (VENT + DUMP + "  - {hold: 61 s}\n" + END, "61 s is outside 0 s to 60 s"),
        ("  - {hold: 11 s}\n" + VENT + DUMP + END, "waits 11 s before it vents"),
        ("  - {ramp_down: pressure, at: 100 kPa/s, within: 5 s}\n" + VENT + DUMP + END, "the ramp takes up to 6 s"),
        ("  - {ramp_down: pressure, at: -100 kPa/s, within: 5 s}\n" + VENT + DUMP + END, "a rate above zero"),
        ("  - {ramp_down: pressure, within: 5 s}\n" + VENT + DUMP + END, '"ramp_down" needs "at"'),
        ("  - {drive_quick_stop: pressure, within: 1 s}\n" + VENT + DUMP + END, "is not a drive"),
        ("  - {drive_quick_stop: displacement, within: 1 s}\n" + VENT + DUMP + END, "no output that takes values"),
        ("  - {hold: 1 s, within: 2 s}\n" + VENT + DUMP + END, 'does not belong to "hold"'),
        ("  - {set: pressure, to: 0 kPa}\n" + DUMP + END, '"set" needs "within"'),
        ("  - {set: pressure, to: 0 kPa, within: 0 s}\n" + DUMP + END, "above zero"),
        (VENT + DUMP + "  - {confirm: pressure, below: 300 kPa, within: 5 s}\n", "it would confirm no vent"),
        (VENT + DUMP + "  - {confirm: pressure, below: -60 kPa, within: 5 s}\n", "above zero is expected"),
    ],
)
def test_a_safe_state_that_is_not_safe_is_refused(tmp_path, actions, says):
    assert says in str(refused(rig(tmp_path, "safe_state:\n" + actions)))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("watchdog: 1 s", "watchdog: 1 h", "3600 s is outside 0 s to 10 s"),
        ("plates: [10 x 5 kg]", "g: 9.81 mm/s2", "0.00981 m/s² is outside 9.7 m/s² to 9.9 m/s²"),
        ("plates: [10 x 5 kg]", "carriage: -2 kg", "not below zero"),
        ("hanger: 1.1 kg", "hanger: -1.1 kg", "not below zero"),
        ("catch_height: 50 mm", "catch_height: 50 m", "50000 mm is outside 0 mm to 1000 mm"),
        ("catch_height: 50 mm", "catch_height: -50 mm", "is outside 0 mm to 1000 mm"),
        ("trip_low: -30 kPa", "trip_low: 30 kPa", "the bench would trip where it rests"),
        ("trip: 1900 N", "trip_low: 0 N", "the bench would trip where it rests"),
        ("proof: {pressure: 50 kPa, below: 20 kPa", "proof: {pressure: 50 kPa, below: 49 kPa", "at most 0.8 of"),
        ("below: 20 kPa, within: 2 s", "below: 20 kPa, within: 1 h", "3600 s is outside 0 s to 60 s"),
        ("within: 2 s}\nsetup", "within: 2 s, fill: 1 h}\nsetup", "3600 s is outside 0 s to 60 s"),
        ("hands:", "slack_below: 5000 N\nhands:", "5000 N is outside 0 N to 100 N"),
        ("hands:", "slack_below: -1 N\nhands:", "-1 N is outside 0 N to 100 N"),
    ],
)
def test_a_value_of_another_size_than_benches_have_is_refused_at_its_place(tmp_path, old, new, says):
    path = rig(tmp_path, old=old, new=new)
    (problem,) = refused(path).problems
    assert says in problem.message
    assert new.splitlines()[0] in path.read_text().splitlines()[problem.line - 1]


@pytest.mark.parametrize("action", ["warn", "hold"])
def test_a_lower_bound_above_rest_that_ends_nothing_is_accepted(tmp_path, action):
    """A rope that goes slack: the bench only warns or waits where it rests."""
    path = rig(tmp_path, old="trip: 1900 N, action: stop", new=f"trip: 1900 N, trip_low: 5 N, action: {action}")
    (found,) = [trip for trip in mount(path, SPECIMEN).bench.trips if (trip.channel, trip.kind) == ("force", "range")]
    assert (found.low, found.high, found.action) == (5.0, 1900.0, action)


DRIVEN = (
    "free_end: actuator\nweights: null\nactuator: {stroke: [-2 mm, 60 mm], speed: 500 mm/s, force: 1500 N}\n"
    "outputs:\n  displacement: {device: daq, output: x, scale: [[0 mm, 0 mm], [60 mm, 60 mm]]}\n"
    "limits:\n  displacement: {command: 50 mm}\n"
)
STOP = "  - {drive_quick_stop: displacement, within: 1 s}\n"
RAMP = "  - {ramp_down: pressure, at: 100 kPa/s, within: 6 s}\n"


@pytest.mark.parametrize(
    ("actions", "says"),
    [
        (VENT + DUMP + END, 'leaves "displacement" moving: add'),
        (RAMP + DUMP + STOP + END, 'leaves "displacement" moving while "ramp pressure" goes on, up to 6 s'),
        ("  - {hold: 9 s}\n" + STOP + VENT + DUMP + END, 'moving while "hold" goes on, up to 9 s'),
        (
            VENT + DUMP + END + "  - {set: displacement, to: 0 mm, within: 1 s}\n",
            'moving while "confirm pressure" goes on',
        ),
    ],
)
def test_a_drive_that_is_left_moving_is_refused(tmp_path, actions, says):
    """A ramp of 5 s before the quick stop left a drive in its sine for so long."""
    assert says in str(refused(rig(tmp_path, DRIVEN + "safe_state:\n" + actions)))
    for first in (STOP, VENT + DUMP + STOP):  # nothing before it is waited for
        assert "moving" not in str(refused(rig(tmp_path, f"{DRIVEN}safe_state:\n{first}{RAMP}{DUMP}{END}")))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ("outputs: {dump_valve: {energised: shut}}\n", "is not known here"),
        ("outputs: {dump_valve: {device: dac}}\n", 'did you mean "daq"'),
        ("outputs: {vent: {device: daq, output: x, scale: [[0 V, 0 kPa], [1 V, 1 kPa]]}}\n", 'needs "energised'),
        ("outputs: {supply_valve: {device: daq, output: x, energised: open}}\n", 'nothing of the valve "supply_valve"'),
        ("interlocks:\n  - {name: a, input: {device: dac, input: x}}\n", 'did you mean "daq"'),
        (
            "interlocks:\n  - {name: a, input: {device: daq, input: x}}\n  - {name: a, input: {device: daq, input: y}}\n",
            'two interlocks "a"',
        ),
        ("no_watchdog: {accepted_by: AB}\n", '"reason" is missing'),
        ("no_watchdog: {accepted_by: '', date: 2026-11-20, reason: x}\n", "at least 1 character"),
    ],
)
def test_wrong_valves_and_interlocks_are_refused(tmp_path, changes, says):
    assert says in str(refused(rig(tmp_path, changes)))


TWO = "devices:\n  daq: {address: %s}\n  again: {driver: mock-realtime, address: %s}\n"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ("channels: {supply: {input: pressure}}\n", 'the input daq.pressure is that of "pressure" ('),
        ("outputs: {dump_valve: {output: pressure}}\n", 'the output daq.pressure is that of "pressure" ('),
        (TWO % ("127.0.0.1:9", "127.0.0.1:9"), '127.0.0.1:9 unit 1 is that of "daq" ('),
        (TWO % ("127.0.0.1:9", "127.0.0.1:10"), ""),
    ],
)
def test_what_is_wired_or_addressed_twice_is_refused_with_both_places(tmp_path, changes, says):
    """A second regulator with the address of the first is never vented, and its vent is confirmed by the first."""
    path = rig(tmp_path, changes)
    if not says:
        assert mount(path, SPECIMEN).lacks == ()
        return
    assert any(says in each.message and ".yaml:" in each.message for each in refused(path).problems)


def test_a_supply_valve_is_left_closed_and_is_open_in_a_run(tmp_path):
    path = rig(
        tmp_path,
        "outputs: {supply_valve: {device: daq, output: isolation_valve, energised: open}}\n"
        f"safe_state:\n  - {{close: supply_valve, within: 1 s}}\n{VENT}{DUMP}{END}",
    )
    found = {valve.name: valve.safe for valve in mount(path, SPECIMEN).bench.valves}
    assert found == {"dump_valve": "open", "supply_valve": "closed"}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ("devices: {daq: {driver: mock}}\n", "has no watchdog"),
        ("outputs: {pressure: {device: cell}}\n", "takes no set-points"),
        ("outputs: {dump_valve: {device: cell}}\n", "switches no valves"),
        ("interlocks:\n  - {name: a, input: {device: cell, input: x}}\n", "has no digital inputs"),
    ],
)
def test_what_a_driver_cannot_do_is_refused_before_it_is_opened(tmp_path, changes, says):
    options = "{poll: P, pattern: '(?P<value>[0-9]+)', rate: 10 Hz}"
    cell = f"  cell: {{driver: serial-ascii, address: /dev/ttyUSB0, options: {options}}}\n"
    path = rig(tmp_path, old="devices:\n", new="devices:\n" + cell)
    (tmp_path / "bench.yaml").write_text("include: rig.yaml\n" + changes)
    assert path.name == "rig.yaml"
    error = refused(tmp_path / "bench.yaml")
    assert says in error.problems[0].message
    assert all('the driver "' in problem.message for problem in error.problems)


# -- calibrations ---------------------------------------------------------------------------------------------------


def test_a_bench_finds_the_calibrations_of_the_bench_that_it_includes(tmp_path):
    there, here = tmp_path / "shipped" / "benches", tmp_path / "lab" / "benches"
    here.mkdir(parents=True)
    shutil.copytree(BENCHES, there)
    path = here / "mine.yaml"
    path.write_text("include: ../../shipped/benches/mock.yaml\nname: mine\n")
    assert mount(path, SPECIMEN).bench.channels[0].calibration.id == "MOCK-P"
    own = here / "calibrations"
    own.mkdir()
    text = (there / "calibrations" / "MOCK-P.yaml").read_text().replace("MOCK-P", "MY-P")
    (own / "MY-P.yaml").write_text(text)
    path.write_text(path.read_text() + "channels: {pressure: {calibration: MY-P}}\n")
    ids = {channel.name: channel.calibration.id for channel in mount(path, SPECIMEN).bench.channels}
    assert (ids["pressure"], ids["displacement"]) == ("MY-P", "MOCK-X")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("id: MOCK-P", "id: MOCK-Q"), "is not the name of the file"),
        (lambda text: text.replace("quantity: pressure", "quantity: force"), "the channel measures pressure"),
        (lambda text: text.replace("[0 count, -50 kPa]", "[0 V, -50 kPa]"), "in one unit"),
        (lambda text: text.replace("1.5 kPa", "-1.5 kPa"), "not below zero"),
        (lambda text: text.replace("1.5 kPa", "1.5 mm"), "no unit of pressure"),
        (lambda text: text + "valid_until: 2020-01-01\n", "before the calibration was made"),
        (lambda text: text.replace("reference:", "referense:"), ""),
        (lambda text: "", "is empty"),
        (None, "no calibration"),
    ],
)
def test_a_faulty_calibration_is_one_problem_without_others_behind_it(tmp_path, change, says):
    path = rig(tmp_path)
    file = tmp_path / "calibrations" / "MOCK-P.yaml"
    if change is None:
        file.unlink()
    else:
        file.write_text(change(file.read_text()))
    with pytest.raises(InvalidFile, match=says or "referense") as caught:
        mount(path, SPECIMEN)
    places = {problem.path for problem in caught.value.problems}
    assert len(places) == 1, caught.value
    assert len(caught.value.problems) == (2 if says == "" else 1), caught.value  # an unknown key is a missing one too


@pytest.mark.parametrize("name", ["../calibrations/MOCK-P", "x" * 500, '"\\0"', "calibrations/MOCK-P"])
def test_the_id_of_a_calibration_is_a_name_and_not_a_path(tmp_path, name):
    error = refused(rig(tmp_path, f"channels: {{pressure: {{calibration: {name}}}}}\n"))
    assert "letters, digits" in str(error)
    assert len(error.problems) == 1


def test_a_scale_beyond_all_range_is_refused(tmp_path):
    error = refused(rig(tmp_path, "outputs: {pressure: {scale: [[-1e308 V, 0 kPa], [1e308 V, 1000 kPa]]}}\n"))
    assert "out of all range" in str(error)


def test_an_unknown_device_is_one_problem(tmp_path):
    error = refused(rig(tmp_path, "channels: {pressure: {device: dac}}\n"))
    assert len(error.problems) == 1, error


def test_a_calibration_that_has_expired_is_lacking_from_the_day_after(tmp_path):
    path = rig(tmp_path)
    file = tmp_path / "calibrations" / "MOCK-F.yaml"
    file.write_text(file.read_text() + "valid_until: 2027-03-01\n")
    assert mount(path, SPECIMEN, datetime.date(2027, 3, 1)).lacks == ()
    (lack,) = mount(path, SPECIMEN, datetime.date(2027, 3, 2)).lacks
    assert "expired calibration of force, MOCK-F, valid until 2027-03-01" in lack


# -- what a bench lacks ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("relief_valve: 680 kPa, ", "", "no relief valve"),
        ("{driver: mock-realtime, watchdog: 1 s}", "{driver: mock-realtime}", "no watchdog of daq"),
        ("  - {name: e-stop, input: {device: daq, input: e_stop}, safe: high}\n", "", "no interlock"),
        ("proof: {pressure: 50 kPa, below: 20 kPa, within: 2 s}\n", "", "no proof"),
        (", catch_height: 50 mm", "", "no catch height"),
        ("below: 20 kPa, within: 5 s}", "below: 20 kPa, within: 2.9 s}", "2.9 s to confirm pressure"),
        ("energised: closed", "energised: open", "no normally-open dump valve"),
        ("supply: 690 kPa", "supply: 640 kPa", "a supply of 640 kPa"),
        ("range: [-5 mm, 90 mm], calibration: MOCK-X", "range: [-5 mm, 90 mm], unit: mm", "no calibration of displac"),
        ("  - {stale: pressure, for: 100 ms, action: vent}\n  - {frozen: pressure, for: 5 s, action: stop}\n",
         "", "dead pressure sensor"),
    ],
)  # fmt: skip
def test_each_lack_is_said_alone_with_its_remedy(tmp_path, old, new, says):
    text = rig(tmp_path).read_text()
    if old.startswith("  - {name"):
        old, new = "interlocks:\n" + old, ""
    path = rig(tmp_path, old=old, new=new)
    assert text != path.read_text()
    (lack,) = mount(path, SPECIMEN).lacks
    assert says in lack
    assert "remedy" in lack


def test_a_gauge_that_may_stand_still_unseen_is_said(tmp_path):
    path = rig(tmp_path, old="  - {frozen: pressure, for: 5 s, action: stop}\n", new="")
    text = path.read_text()
    path.write_text(text.replace("  - {following: pressure, more_than: 60 kPa, for: 2 s, action: hold}\n", ""))
    (lack,) = mount(path, SPECIMEN).lacks
    assert "stands still while its device answers" in lack
    assert "remedy" in lack


@pytest.mark.parametrize(
    ("bench", "old", "says"),
    [
        ("can", r"  - \{following: displacement.*\n", "goes where it was not sent"),
        ("can", "action: vent}   # a drive", "goes where it was not sent"),
        ("can", ", trip_low: -3 mm, action: vent", "no lower limit of the displacement, to which a drive may stretch"),
        ("can", r"    watchdog: 500 ms   .*\n", "no watchdog of bus: a computer that dies leaves a drive in motion"),
        ("festo-sine", r"  - \{following: displacement.*\n", "goes where it was not sent"),
    ],
)
def test_a_drive_that_may_go_anywhere_is_said(tmp_path, bench, old, says):
    shutil.copytree(BENCHES, tmp_path / "benches")
    path = tmp_path / "benches" / f"{bench}.yaml"
    text = path.read_text()
    path.write_text(re.sub(old, "action: warn}   # a drive" if old.startswith("action") else "", text))
    assert mount(BENCHES / f"{bench}.yaml", SPECIMEN).lacks == ()
    (lack,) = mount(path, SPECIMEN).lacks
    assert says in lack
    assert "remedy" in lack


def test_a_drive_cannot_be_sent_to_where_it_trips(tmp_path):
    shutil.copytree(BENCHES, tmp_path / "benches")
    path = tmp_path / "benches" / "mine.yaml"
    path.write_text("include: mock-actuator.yaml\nlimits: {displacement: {trip_low: -10 um}}\n")
    assert "below the lowest command 0 mm (" in str(refused(path))


def test_a_pressure_that_the_guard_cannot_read_is_said_with_its_place(tmp_path):
    path = rig(tmp_path, "devices: {only: {driver: mock-realtime}}\nchannels: {pressure: {device: only}}\n")
    (lack,) = mount(path, SPECIMEN).lacks
    assert lack.startswith("its pressure on only, which only measures (")
    assert "bench.yaml:3:31)" in lack
    assert "remedy" in lack


def test_a_missing_watchdog_that_is_accepted_says_by_whom(tmp_path):
    path = rig(
        tmp_path,
        "devices: {daq: {watchdog: null}}\n"
        "no_watchdog: {accepted_by: AB, date: 2026-11-20, reason: hard-wired dump valve}\n",
    )
    (lack,) = mount(path, SPECIMEN).lacks
    assert lack == "no watchdog of daq, accepted by AB on 2026-11-20: hard-wired dump valve"


def test_a_specimen_file_that_is_unusable_is_reported_with_the_bench(tmp_path):
    error = refused(rig(tmp_path, "nonsense: 1\n"), specimen(tmp_path, "make:", "maker:"))
    assert {problem.path.rsplit("/")[-1] for problem in error.problems} == {"bench.yaml", "specimen.yaml"}
