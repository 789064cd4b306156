"""What happens when something fails follows from valves, watchdogs and watch list, and never promises what is not there."""

from dataclasses import replace

import pytest

from pmabench.bench.card import failure_story, make_card
from pmabench.bench.compile import mount, mount_alone
from tests.bench.benches import BENCHES, SPECIMEN, rig
from tests.engine.platform_rig import SHIPPED

NO_DUMP = "outputs: {dump_valve: {energised: open}}\n"
NO_WATCHDOG = "devices: {daq: {watchdog: null}}\n"
DUMP_ELSEWHERE = "  io: {driver: mock-realtime, watchdog: 2 s}\noutputs: {dump_valve: {device: io}}\n"


def story(tmp_path, changes=""):
    return dict(failure_story(mount(rig(tmp_path, changes), SPECIMEN)))


def test_a_bench_that_lacks_nothing_vents_whatever_fails(tmp_path):
    reported = story(tmp_path)
    assert reported["The computer"] == "daq hears nothing and vents by itself after 1 s and opens the dump valve."
    assert reported["Electric power"].startswith("The dump valve opens and the muscle vents")
    assert "Supply below 650 kPa for 1 s: hold." in reported["Compressed air"]
    assert "daq itself vents after 1 s." in reported["Network or cable"]
    assert "tripped" in reported["An interlock"]
    assert not [text for text in reported.values() if any(word.isupper() and len(word) > 3 for word in text.split())]


@pytest.mark.parametrize(
    ("changes", "what", "says"),
    [
        (NO_WATCHDOG, "The computer", "NOTHING VENTS: daq has no watchdog"),
        (NO_WATCHDOG, "Network or cable", "daq keeps its last value: NO WATCHDOG"),
        (NO_DUMP, "Electric power", "THE REGULATOR MAY HOLD THE PRESSURE"),
        (NO_DUMP.replace("{dump", "{pressure: {without_power: vents}, dump"), "Electric power", "The regulator vents"),
        (NO_DUMP + "air: {dump_valve: normally open}\n", "Electric power", "The dump valve opens"),
        (
            "devices:\n  daq: {watchdog: null}\n" + DUMP_ELSEWHERE,
            "The computer",
            "io hears nothing and opens the dump valve after 2 s",
        ),
        (
            "devices:\n  daq: {watchdog: null}\n" + DUMP_ELSEWHERE,
            "The computer",
            "The regulator keeps its last set-point.",
        ),
        ("devices:\n" + DUMP_ELSEWHERE, "The computer", "after 1 s; io opens the dump valve after 2 s."),
        ("weights: {catch_height: null}\n", "Electric power", "NOTHING stops it"),
        ("interlocks: []\n", "An interlock", "DOES NOT SEE IT"),
        ("watch: []\nlimits: {pressure: {trip_low: null}}\n", "Pressure sensor", "A DEAD SENSOR IS NOT NOTICED"),
    ],
)
def test_what_is_missing_is_said_loudly(tmp_path, changes, what, says):
    assert says in story(tmp_path, changes)[what]


def test_air_that_fails_unseen_is_said(tmp_path):
    supply = "  supply: {device: daq, input: supply, range: [0 kPa, 1000 kPa], unit: Pa}\n"
    following = "  - {following: pressure, more_than: 60 kPa, for: 2 s, action: hold}\n"
    path = rig(tmp_path, old=supply, new="")
    assert (
        "ore than 60 kPa from the command for 2 s: hold."
        in dict(failure_story(mount(path, SPECIMEN)))["Compressed air"]
    )
    path.write_text(path.read_text().replace(following, ""))
    assert "NOTHING REPORTS IT" in dict(failure_story(mount(path, SPECIMEN)))["Compressed air"]


def test_a_drive_without_a_watchdog_goes_on(tmp_path):
    driven = (
        "free_end: actuator\nweights: null\nactuator: {stroke: [-2 mm, 60 mm], speed: 500 mm/s, force: 1500 N}\n"
        "devices:\n  drive: {driver: mock, options: {free_end: actuator}}\n"
        "outputs:\n  displacement: {device: drive, output: displacement, scale: [[0 mm, 0 mm], [60 mm, 60 mm]]}\n"
        "limits:\n  displacement: {command: 50 mm}\n"
        "safe_state:\n  - {drive_quick_stop: displacement, within: 200 ms}\n  - {open: dump_valve, within: 1 s}\n"
        "  - {set: pressure, to: 0 kPa, within: 1 s}\n  - {confirm: pressure, below: 20 kPa, within: 5 s}\n"
    )
    assert "THE DRIVE GOES ON" in story(tmp_path, driven)["The computer"]


def test_a_bench_in_virtual_time_pressurises_nothing():
    assert failure_story(mount_alone(BENCHES / "mock.yaml"))[0][0] == "Anything"


def test_a_drive_vents_nothing_by_itself():
    reported = dict(failure_story(mount(BENCHES / "festo-sine.yaml", SPECIMEN)))
    assert "terminal itself vents after 500 ms." in reported["Network or cable"]
    assert "drive itself stops its motion after 500 ms." in reported["Network or cable"]
    assert "The drive's own watchdog ends its motion." in reported["The computer"]


def test_a_bench_with_valves_that_open_in_pulses_says_what_stays_without_a_computer():
    """Both of its devices' watchdogs are missing: the supply stays on and the dumps shut, and the card says so."""
    real = replace(SHIPPED, bench=replace(SHIPPED.bench, realtime=True))
    reported = dict(failure_story(real))["The computer"]
    assert "THE SUPPLY VALVE STAYS AS IT IS" in reported
    assert "THE DUMP VALVE STAYS AS IT IS" in reported
    (device,) = SHIPPED.bench.devices
    guarded = replace(SHIPPED, bench=replace(real.bench, devices=(replace(device, watchdog=1.0),)))
    reported = dict(failure_story(guarded))["The computer"]
    assert "plant hears nothing and lets go of the supply valve after 1 s" in reported


def test_the_card_of_a_platform_says_what_valves_may_bring_about():
    made = make_card(SHIPPED, "2026-11-24")
    rows = {row[0]: row[1] for row in made.limits}
    assert rows["pressure_1"] == "20 kPa to 550 kPa"
    assert rows["tilt"] == "0 deg to 20 deg"
    assert made.watch[0][0] == "all muscles"
