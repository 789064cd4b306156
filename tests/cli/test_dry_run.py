"""`check --simulate` of a lab's own bench: no device is opened, idle trials are named and can be dropped."""

import json
import socket
from pathlib import Path

import pytest
from click.testing import CliRunner
from serial import Serial

from pmabench.cli.main import main
from tests.analysis.simulate import rig

ROOT = Path(__file__).resolve().parents[2]
OF = ["--specimen", "mas-20-250-paper0"]
FIVE = ["labjack", "ni", "serial", "wires", "alicat"]
SHORT = [
    "--set", "sweep.repeat.count=1", "--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[200 kPa, 500 kPa]",
]  # fmt: skip


def check(*words, code=0):
    done = CliRunner().invoke(main, ["check", *map(str, words)])
    assert done.exit_code == code, done.output
    return done


@pytest.fixture
def no_device(monkeypatch):
    """Sockets and serial ports that cannot be opened."""

    def refuse(*_args, **_kwargs):
        raise AssertionError("a dry run opened a device")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(Serial, "open", refuse)


@pytest.mark.parametrize("bench", FIVE)
def test_a_bench_with_devices_is_run_without_opening_one(bench, no_device):
    reported = json.loads(check("contraction-relaxation", "--bench", bench, *OF, *SHORT, "--simulate", "--json").stdout)
    simulated = reported["simulated"]
    assert (simulated["status"], simulated["exit_code"]) == ("finished", 0)
    assert "reference plant 5.1" in simulated["muscle"]
    muscle = rig().muscle
    highest = (muscle.F_ce(500e3) - muscle.friction.F_c - 58.86) / muscle.K(500e3)
    assert simulated["measured"]["displacement"]["highest"] == pytest.approx(highest, rel=0.05)
    assert simulated["measured"]["pressure"]["highest"] == pytest.approx(500e3, rel=0.01)


def test_trials_that_cannot_lift_are_named_and_dropped(tmp_path):
    """The shipped sweep: by the plant's own coefficients 45 of 88 points do not lift, one by 10 N only."""
    muscle, point = rig().muscle, []
    for load in (9.81 * kg for kg in range(6, 57, 5)):
        point += [muscle.F_ce(1e3 * P) - load for P in range(150, 501, 50)]
    cannot, hardly = sum(margin <= 6 for margin in point), sum(6 < margin < 12 for margin in point)  # F_c = 6 N
    assert (cannot, hardly) == (45, 1)
    out = tmp_path / "moving.yaml"
    reported = json.loads(
        check("contraction-relaxation", "--bench", "labjack", *OF, "--drop-idle", "-o", out, "--json").stdout
    )
    assert (len(reported["idle"]["trials"]), len(reported["idle"]["doubtful"]), reported["trials"]) == (90, 2, 176)
    left = json.loads(check(out, "--bench", "labjack", *OF, "--plan", "--json").stdout)
    assert left["trials"] == 84
    assert not left["idle"]["trials"]
    assert "accept:" in out.read_text()
    human = check("contraction-relaxation", "--bench", "labjack", *OF).stdout
    assert "!  90 of 176 trials are not expected to lift their load, 2 more may not" in human
    again = check("contraction-relaxation", "--bench", "labjack", *OF, "--drop-idle", "-o", out, code=2)
    assert "is there already" in again.stderr


def test_without_expected_coefficients_the_type_is_simulated_and_says_so(tmp_path, no_device):
    """The force of a DMSP-20 at 500 kPa is 756 N at 8 % and 262 N at 19.5 % (the maker's catalogue)."""
    text = (ROOT / "fixtures" / "specimens" / "mas-20-250-paper0.yaml").read_text()
    (tmp_path / "new.yaml").write_text(text[: text.index("expected:")])
    words = ["contraction-relaxation", "--bench", "labjack", "--specimen", tmp_path / "new.yaml"]
    sweep = [
        "--set",
        "sweep.repeat.count=1",
        "--set",
        "sweep.matrix.load=[26 kg]",
        "--set",
        "sweep.matrix.pressure=[500 kPa]",
    ]
    reported = json.loads(check(*words, *sweep, "--simulate", "--json").stdout)["simulated"]
    assert "type MAS-20 of the library" in reported["muscle"]
    (trial,) = reported["predicted"]
    assert trial["highest"]["displacement"] == pytest.approx(0.25 * 0.195, rel=0.05)  # 255 N, less half of the loop
    assert [other["force"] for other in reported["others"]] == [0.8, 1.2]
    weak, strong = (other["contraction"] for other in reported["others"])
    assert weak < trial["highest"]["displacement"] < strong


def test_intervals_of_the_plan_are_predicted_and_more_trials_make_them_narrower():
    """Where trials scatter alike, four repeats halve what one repeat leaves open."""
    halves = []
    for count in (1, 4):
        sweep = ["--set", "sweep.matrix.load=[6 kg, 11 kg, 16 kg]", "--set", "sweep.matrix.pressure=[300 kPa, 400 kPa]"]
        sweep += ["--set", f"sweep.repeat.count={count}"]
        reported = json.loads(
            check("contraction-relaxation", "--bench", "labjack", *OF, *sweep, "--simulate", "--json").stdout
        )
        found = {(one["symbol"], one["pressure"]): one for one in reported["simulated"]["intervals"]}
        assert found["K", 400e3]["value"] == pytest.approx(rig().muscle.K(400e3), rel=0.01)
        halves.append(found["K", 400e3]["half"])
    assert halves[1] == pytest.approx(0.5 * halves[0], rel=0.05)
