"""S1: each limit deleted, made absurd or swapped, one at a time, is refused with a place, or another one binds."""

import re
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from tests.bench.benches import RIG, SPECIMEN, rig, specimen


def refused(bench: Path, muscle: Path = SPECIMEN) -> str:
    with pytest.raises(InvalidFile) as caught:
        mount(bench, muscle)
    assert all(problem.line > 0 for problem in caught.value.problems), caught.value
    return str(caught.value)


DELETED = {
    "command: 600 kPa, ": "has no command limit",
    "trip: 650 kPa, ": "has no trip limit",
    "  pressure: {command: 600 kPa, trip: 650 kPa, trip_low: -30 kPa, delay: 4 ms, action: vent}\n": "no trip limit",
    "  - {set: pressure, to: 0 kPa, within: 200 ms}\n  - {open: dump_valve, within: 200 ms}\n": "dump valve",
    "  - {confirm: pressure, below: 20 kPa, within: 5 s}\n": "does not look",
    "hands: {below: 20 kPa}\n": '"hands" is missing',
    "air: {supply: 690 kPa, relief_valve: 680 kPa, overshoot: 10 kPa}\n": '"air" is missing',
    "  displacement: {device: daq, input: displacement, range: [-5 mm, 90 mm], calibration: MOCK-X}\n": "displacement",
    "  pressure: {device: daq, input: pressure, range: [0 count, 65535 count], calibration: MOCK-P}\n": "pressure",
    "  force: {device: daq, input: force, range: [0 count, 65535 count], at: fixed end, calibration: MOCK-F}\n": "force",
}


@pytest.mark.parametrize("text", DELETED)
def test_a_limit_that_is_missing_is_refused(tmp_path, text):
    assert DELETED[text] in refused(rig(tmp_path, old=text, new=""))


@pytest.mark.parametrize(
    "text", ["command: 600 kPa, never_above: 700 kPa", "never_above: 700 kPa", "contraction: 28 %, "]
)
def test_a_limit_of_the_specimen_that_is_missing_is_refused(tmp_path, text):
    assert "is missing" in refused(rig(tmp_path), specimen(tmp_path, text, ""))


def test_without_the_bench_s_contraction_limit_the_specimen_s_is_watched(tmp_path):
    trips = mount(rig(tmp_path, old="  contraction: {trip: 25 %, action: vent}\n", new=""), SPECIMEN).bench.trips
    (trip,) = (trip for trip in trips if trip.channel == "displacement")
    assert trip.high == pytest.approx(0.07)
    assert trip.action == "vent"


@pytest.mark.parametrize("action", ["warn", "hold"])
def test_a_contraction_limit_that_only_warns_does_not_replace_the_specimen_s(tmp_path, action):
    path = rig(tmp_path, old="{trip: 25 %, action: vent}", new=f"{{trip: 25 %, action: {action}}}")
    found = {
        round(trip.high, 6): trip.action for trip in mount(path, SPECIMEN).bench.trips if trip.channel == "displacement"
    }
    assert found == {0.0625: action, 0.07: "vent"}


@pytest.mark.parametrize("below", ["51 kPa", "500 kPa", "20 bar"])
def test_hands_do_not_go_in_under_pressure(tmp_path, below):
    """It bounds what confirms a vent: with 500 kPa, a muscle stuck at 200 kPa was "vented"."""
    vented = "confirm: pressure, below: 20 kPa"
    path = rig(tmp_path, old="hands: {below: 20 kPa}", new=f"hands: {{below: {below}}}")
    assert "hands may go in at 50 kPa at most" in refused(path)
    assert "would confirm no vent" in refused(rig(tmp_path, old=vented, new=vented.replace("20", "21")))


NUMBERS = ["command: 600 kPa", "trip: 650 kPa", "trip: 25 %", "trip: 1900 N", "supply: 690 kPa", "relief_valve: 680 kPa",
           "setup_pressure: 80 kPa", "pressure: 50 kPa", "below: 20 kPa, within: 5 s", "ramp: 500 kPa/s",
           "at: 500 kPa/s", "falls: 60 kPa", "more_than: 60 kPa", "faster_than: 5000 kPa/s", "below: 20 kPa}",
           "1000 kPa]]}", "delay: 4 ms", "watchdog: 1 s", "within: 50 ms", "for: 5 s"]  # fmt: skip
ABSURD = [".nan", "nan", "1e999", "-inf", "-1"]


@pytest.mark.parametrize("absurd", ABSURD)
@pytest.mark.parametrize("text", NUMBERS)
def test_no_limit_of_a_bench_can_be_absurd(tmp_path, text, absurd):
    new = re.sub(r"-?\d+(?= ?(?:kPa|N|%|s|ms))", absurd, text, count=1)
    assert new != text
    refused(rig(tmp_path, old=text, new=new))


@pytest.mark.parametrize("absurd", ABSURD)
@pytest.mark.parametrize(
    "text", ["command: 600 kPa", "never_above: 700 kPa", "contraction: 28 %", "length: 250 mm, at"]
)
def test_no_limit_of_a_specimen_can_be_absurd(tmp_path, text, absurd):
    refused(rig(tmp_path), specimen(tmp_path, text, re.sub(r"\d+", absurd, text, count=1)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("command: 600 kPa, trip: 650 kPa", "command: 650 kPa, trip: 600 kPa"),
        ("trip: 650 kPa, trip_low: -30 kPa", "trip: -30 kPa, trip_low: 650 kPa"),
        ("pressure: 50 kPa, below: 20 kPa", "pressure: 20 kPa, below: 50 kPa"),
        ("command: 600 kPa", "command: 600 kPa, command_low: 600 kPa"),
    ],
)
def test_swapped_limits_are_refused(tmp_path, old, new):
    refused(rig(tmp_path, old=old, new=new))


def test_a_specimen_whose_limits_are_swapped_is_refused(tmp_path):
    swapped = specimen(tmp_path, "command: 600 kPa, never_above: 700 kPa", "command: 700 kPa, never_above: 600 kPa")
    assert '"command" must lie below "never_above"' in refused(rig(tmp_path), swapped)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("trip: 650 kPa", "trip: 611 kPa", "must lie at least 11.5 kPa"),  # 1.5 kPa of MOCK-P and 10 kPa of overshoot
        ("trip: 650 kPa", "trip: 700 kPa", "never_above"),
        ("relief_valve: 680 kPa", "relief_valve: 700 kPa", "not below the specimen's never_above"),
        ("relief_valve: 680 kPa", "relief_valve: 600 kPa", "opens below what may be commanded"),
        ("range: [-5 mm, 90 mm]", "range: [-5 mm, 60 mm]", "channel's range"),
        ("trip: 1900 N", "trip: 1960 N", "channel's range"),
        ("range: [0 count, 65535 count], at", "range: [-50 N, 3000 N], at", ""),
        ("trip_low: -30 kPa, delay: 4 ms, action: vent", "delay: 4 ms, action: stop", 'must "vent"'),
        ("delay: 4 ms", "delay: 2 s", "no protection"),
        ("force: {trip: 1900 N", "force: {command: 100 N, trip: 1900 N", 'nothing commands "force"'),
        ("scale: [[0 V, 0 kPa]", "safe: 50 kPa, scale: [[0 V, 0 kPa]", "leaves pressure on"),
        ("setup_pressure: 80 kPa", "setup_pressure: 601 kPa", "above the command limit"),
        ("proof: {pressure: 50 kPa", "proof: {pressure: 90 kPa", "above the set-up pressure"),
    ],
)
def test_limits_must_make_sense_together(tmp_path, old, new, says):
    path = rig(tmp_path, old=old, new=new)
    if says:
        assert says in refused(path)
    else:
        mount(path, SPECIMEN)


def test_a_trip_beyond_what_the_calibration_covers_is_refused(tmp_path):
    path = rig(tmp_path, old="range: [0 count, 65535 count], at", new="range: [-50 N, 3000 N], at")
    path.write_text(path.read_text().replace("trip: 1900 N", "trip: 2500 N"))
    assert "is not inside the calibration MOCK-F, -50 N to 1950 N" in refused(path)


def calibration_to(tmp_path, most):
    """The rig with a calibration of the pressure from 0 to so many kPa, U = 1.5 kPa."""
    path = rig(tmp_path)
    text = (tmp_path / "calibrations" / "MOCK-P.yaml").read_text()
    points = f"points: [[3277 count, 0 kPa], [{round((most + 50) * 65.535)} count, {most} kPa]]"
    text = "\n".join(points if line.startswith("points:") else line for line in text.splitlines()) + "\n"
    (tmp_path / "calibrations" / "MOCK-P.yaml").write_text(text.replace("gain_uncertainty: 0.2 %", ""))
    return path


def test_a_calibration_up_to_the_command_limit_is_believed_up_to_the_trip(tmp_path):
    """U (1 + 2 d): 1.5 kPa at 0 to 600 kPa is 1.75 kPa at 650 kPa and 1.65 kPa at -30 kPa."""
    [said] = [line for line in mount(calibration_to(tmp_path, 600), SPECIMEN).lacks if "calibration" in line]
    assert "-30 kPa of pressure (MOCK-P; +-1.65 kPa there)" in said
    assert "650 kPa of pressure (MOCK-P; +-1.75 kPa there)" in said
    path = tmp_path / "rig.yaml"
    for trip, fine in ((611.61, True), (611.5, False)):  # 600 + 10 of overshoot + 1.5 (1 + 2 x 11.6 / 600)
        path.write_text(RIG.replace("trip: 650 kPa", f"trip: {trip:.2f} kPa"))
        if fine:
            mount(path, SPECIMEN)
        else:
            assert "must lie at least" in refused(path)


def test_a_calibration_that_ends_far_below_the_trip_is_refused(tmp_path):
    assert not [line for line in mount(rig(tmp_path), SPECIMEN).lacks if "calibration" in line]
    said = refused(calibration_to(tmp_path, 500))
    assert "650 kPa is not inside the calibration MOCK-P, 0 kPa to 500 kPa, nor within 125 kPa of it" in said


def test_the_gain_uncertainty_of_a_calibration_enters_the_margin(tmp_path):
    path = rig(tmp_path)
    calibration = tmp_path / "calibrations" / "MOCK-P.yaml"
    calibration.write_text(calibration.read_text() + "gain_uncertainty: 10 %\n")
    assert "must lie at least 76.5 kPa" in refused(path)  # 1.5 + 10 % of 650 + 10 of overshoot


def test_the_margin_is_just_enough_at_its_edge(tmp_path):
    rig(tmp_path)
    for trip, fine in ((611.6, True), (611.5, True), (611.4, False)):  # 600 + 1.5 of MOCK-P + 10 of overshoot
        text = RIG.replace("trip: 650 kPa", f"trip: {trip:.1f} kPa")
        (tmp_path / "rig.yaml").write_text(text)
        if fine:
            mount(tmp_path / "rig.yaml", SPECIMEN)
        else:
            assert "must lie at least" in refused(tmp_path / "rig.yaml")


def test_the_specimen_s_contraction_binds_a_driven_end(tmp_path):
    path = rig(
        tmp_path,
        "free_end: actuator\nweights: null\nactuator: {stroke: [-2 mm, 60 mm], speed: 500 mm/s, force: 1500 N}\n"
        "devices: {daq: {options: {free_end: actuator}}}\n"
        "outputs:\n  displacement: {device: daq, output: displacement, scale: [[0 mm, 0 mm], [60 mm, 60 mm]]}\n"
        "limits:\n  displacement: {command: 50 mm}\n"
        "safe_state:\n  - {drive_quick_stop: displacement, within: 200 ms}\n"
        "  - {set: pressure, to: 0 kPa, within: 1 s}\n  - {open: dump_valve, within: 1 s}\n"
        "  - {confirm: pressure, below: 20 kPa, within: 5 s}\n",
    )
    short = mount(path, specimen(tmp_path, "contraction: 28 %", "contraction: 12 %")).bench
    output = next(output for output in short.outputs if output.name == "displacement")
    assert output.high == pytest.approx(0.030 - 30e-6)  # 12 % of 250 mm, less 0.1 % (MOCK-X: 20 um)
    assert "specimen.yaml" in output.high_from
    assert [trip.high for trip in short.trips if trip.channel == "displacement"] == [pytest.approx(0.030)]
    fine = mount(path, SPECIMEN).bench
    assert next(output for output in fine.outputs if output.name == "displacement").high == pytest.approx(0.05)
    assert fine.safe_state[0].do == "stop"


def test_a_measured_supply_must_stay_above_every_set_point(tmp_path):
    trip = next(trip for trip in mount(rig(tmp_path), SPECIMEN).bench.trips if trip.channel == "supply")
    assert (trip.low, trip.high, trip.action) == (650e3, None, "hold")
    assert "50 kPa above the highest set-point" in refused(
        rig(tmp_path, "limits: {supply: {trip_low: 640 kPa, action: stop}}\n")
    )
    own = mount(rig(tmp_path, "limits: {supply: {trip_low: 655 kPa, action: stop}}\n"), SPECIMEN).bench.trips
    assert [(t.low, t.action) for t in own if t.channel == "supply"] == [(655e3, "stop")]
    lower = specimen(tmp_path, "command: 600 kPa", "command: 400 kPa")
    trip = next(trip for trip in mount(rig(tmp_path), lower).bench.trips if trip.channel == "supply")
    assert trip.low == 450e3


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("self_test: {}", "self_test: {load: 7 kg}", "nearest: 6.1 kg or 11.1 kg"),
        ("at: free end on its support}", "at: its support, load: 0.5 kg}", "nearest: 0 kg or 1.1 kg"),
    ],
)
def test_a_load_of_the_session_that_the_weights_cannot_make_is_refused_where_it_is(tmp_path, old, new, said):
    """`check` says it, before a person looks for a plate that is not there."""
    path = rig(tmp_path, old=old, new=new)
    message = refused(path)
    assert "cannot be made with the weights of this bench (hanger 1.1 kg and plates 10 x 5 kg)" in message
    assert said in message
    [(number, line)] = [
        (n, line) for n, line in enumerate(path.read_text().split("\n"), 1) if " load: " in line or "{load: " in line
    ]
    assert f"rig.yaml:{number}:{line.index('load: ') + len('load: ') + 1}" in message


def test_a_load_of_the_session_that_the_weights_make_is_taken(tmp_path):
    session = mount(rig(tmp_path, old="self_test: {}", new="self_test: {load: 59.841 N}"), SPECIMEN).session
    assert session.self_test.load == pytest.approx(6.1)
