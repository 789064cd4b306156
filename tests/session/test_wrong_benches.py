"""What the self-test makes of wrong bench files of five rigs, on a bench of plain formulas; and of right ones."""

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.bench.interface import TripRecord
from pmabench.engine.acquire import Tripped
from pmabench.engine.run import Outcome
from pmabench.engine.watch import Trip
from pmabench.session.checks import FAILED, cause_of, words
from pmabench.session.self_test import SelfTesting
from pmabench.session.wiring import Stage, Wiring
from tests.engine.benches import SPECIMEN
from tests.reliability.cases import cases
from tests.session.seen_from_outside import Outside, self_tested
from tests.session.wrong_benches import RIGS, Fault, faults_of, output, plain, rescaled, right_file

UNDECIDABLE = {
    "festo-sine": {"displacement and displacement_command exchanged"},  # one drive gives both, with one scale
}
"""Faults of which a bench has no independent reference."""


@pytest.fixture(scope="module", params=RIGS)
def rig(request, tmp_path_factory):
    """Name, path and compiled bench of a right file."""
    path = right_file(request.param, tmp_path_factory.mktemp(request.param))
    return request.param, path, mount(path, SPECIMEN)


def some_bench(seed, zero=5e-4):
    """A right bench as benches are: it rests anywhere from 0 to 5 mm, its zeros and gains are within their limits."""
    rng = np.random.default_rng(seed)
    return Outside(
        rest=rng.uniform(0.0, 5e-3),
        load=float(rng.choice([0.0, 10.79, 58.86])),
        strength=rng.uniform(0.9, 1.1),
        zeros={
            "pressure": rng.uniform(-3e3, 3e3),
            "force": rng.uniform(-3, 3),
            "displacement": rng.uniform(-5e-4, 5e-4),
        },
        gains={name: rng.uniform(0.99, 1.01) for name in ("pressure", "force", "displacement")},
        seed=seed,
    )


def test_a_right_bench_passes_wherever_it_rests(rig):
    name, _, right = rig
    for seed in range(cases(5)):
        outside = some_bench(seed, zero=5e-4 if seed % 2 else 5e-3)  # the muscle rests there, or the support is there
        checks, failure, _ = self_tested(right, right, outside)
        assert not failure, (name, outside)
        unchecked = {check.name for check in checks if check.verdict == "not checked"} - {"load cell"}
        exchanged = {"plugs of displacement and displacement_command"} if name in UNDECIDABLE else set()
        assert unchecked == exchanged, (name, outside)


@pytest.mark.parametrize("hung", [0.0, 0.5])
def test_of_a_load_that_was_not_hung_the_plates_are_named_first(rig, hung):
    """Nothing, and half of it: the plates, and the cell only after them. At a driven bench nothing is asked for."""
    _, failure, _ = self_tested(rig[2], rig[2], Outside(hung=hung))
    assert ("plates (is the whole load on the free end, and no more?)" in failure) == (
        rig[2].bench.free_end == "weights"
    ), failure
    assert "the scale of the force" not in failure


def test_a_slow_exhaust_is_no_wrong_zero(rig):
    """1.5 s after 100 kPa there are 5.4 kPa left: more than a zero may be off, less than the regulator may."""
    assert self_tested(rig[2], rig[2], Outside(exhaust=0.5))[1] == ""


def test_every_wrong_file_is_found_and_its_wire_is_named(rig, tmp_path):
    name, path, right = rig
    tried = 0
    for number, fault in enumerate(faults_of(name, plain(path))):
        try:
            wrong = mount(fault.wrong_file(path, tmp_path / str(number)), SPECIMEN)
        except InvalidFile:
            continue  # `check` refuses it with its place in the file
        tried += 1
        for seed in range(min(cases(1), 3)):
            _, failure, bench = self_tested(right, wrong, some_bench(seed))
            if fault.name in UNDECIDABLE.get(name, ()):
                assert not failure
            else:
                assert any(terminal in failure for terminal in fault.terminals), (fault.name, seed, failure)
            assert bench.highest < 200e3, (fault.name, seed)  # also where ten times as much is sent as is meant
    assert tried >= 20


def test_without_a_reference_a_scale_is_not_checked_and_passes(tmp_path):
    """The same wrong scales, where neither weights nor the specimen file say what to expect."""
    path = right_file("can", tmp_path / "right")
    nothing = tmp_path / "specimen.yaml"
    nothing.write_text(SPECIMEN.read_text().split("expected:")[0])
    right = mount(path, nothing)
    wrong = mount(Fault("", rescaled("force", 2.0), ()).wrong_file(path, tmp_path / "wrong"), nothing)
    checks, failure, _ = self_tested(right, wrong, Outside())
    assert not failure
    (row,) = [check for check in checks if check.name == "scale of force"]
    assert row.verdict == "not checked"
    assert "no independent reference" in row.hint


def test_the_output_and_the_pressure_are_undecided_without_a_read_back(tmp_path):
    path = right_file("ni", tmp_path / "right")
    bench = plain(path)
    del bench["channels"]["pressure_command"]

    def damage(data, folder):
        del data["channels"]["pressure_command"]
        output("pressure", 2.0)(data, folder)

    wrong = mount(Fault("", damage, ()).wrong_file(path, tmp_path / "wrong"), SPECIMEN)
    _, failure, _ = self_tested(mount(path, SPECIMEN), wrong, Outside())
    assert "undecided between the pressure (daq.ai1), the output pressure (daq.ao0)" in failure


# -- the decision, on readings that are written down -----------------------------------------------------------------


@pytest.fixture(scope="module")
def wiring(tmp_path_factory):
    """0 V to 10 V each: 50 kPa below zero, 5 mm below, 50 N below; gains 100 kPa, 10 mm and 200 N a volt."""
    path = right_file("labjack", tmp_path_factory.mktemp("decision"))
    return Wiring(mount(path, SPECIMEN), {"pressure": 500.0, "force": 0.3, "displacement": 2e-6})


def said(wiring, *stages):
    cause = cause_of(wiring, stages)
    return words(wiring, cause) if cause is not None else ""


def rest(pressure=0.0, force=0.0, displacement=0.0, command=0.0, load=0.0):
    means = {"pressure": pressure, "force": force, "displacement": displacement, "pressure_command": command}
    return Stage(means, load=load)


@pytest.mark.parametrize("x", [0.0, 0.5e-3, 1.26e-3, 5e-3])
def test_a_rest_position_is_no_swap(wiring, x):
    assert said(wiring, rest(displacement=x)) == ""
    assert said(wiring, rest(displacement=x, load=None, force=58.9)) == ""


def test_one_implausible_reading_is_one_wire(wiring):
    only = "look at the wire of the force (t7.AIN2), at its range and at its calibration"
    assert said(wiring, rest(force=50.0), Stage({"force": 50.0})) == only


def test_two_implausible_readings_that_explain_each_other_are_a_swap(wiring):
    """At rest the pressure's 0.5 V reads 50 N as a force, the force's 0.25 V reads -25 kPa as a pressure."""
    swapped = "the plugs of pressure and force are swapped (t7.AIN0 and t7.AIN2)"
    assert said(wiring, rest(pressure=-25e3, force=50.0)) == swapped


def test_two_implausible_readings_that_do_not_explain_each_other_are_no_swap(wiring):
    assert said(wiring, rest(pressure=-25e3, force=300.0)) == "no single wire explains all that is wrong"


def test_a_broken_claim_of_three_that_agree_two_by_two_names_the_one_in_both(wiring):
    """25 kPa commanded and read back, 50 kPa measured: the pressure. Read back 50 too: the output."""
    measured = rest(pressure=50e3, command=25e3)
    assert "the scale of the pressure (t7.AIN0)" in said(wiring, rest(), Stage(measured.means, 25e3))
    both = rest(pressure=50e3, command=50e3)
    assert "the scale of the output pressure (t7.DAC0)" in said(wiring, rest(), Stage(both.means, 25e3))
    back = rest(pressure=25e3, command=50e3)
    assert "the scale of the pressure_command (t7.AIN3)" in said(wiring, rest(), Stage(back.means, 25e3))


def test_a_limit_that_trips_in_the_first_step_still_names_the_wire(wiring):
    """A pressure that falls below its limit at once: its sign."""
    tripped = Stage(rest(pressure=-31e3, command=25e3).means, 25e3, settled=False)
    assert said(wiring, rest(), tripped).startswith("the sign of the pressure (t7.AIN0) is wrong")


def test_what_runs_away_in_the_first_step_is_the_pressure_where_the_read_back_clears_the_output(wiring):
    away = Stage(rest(pressure=120e3, command=25e3).means, 25e3, settled=False)
    assert said(wiring, rest(), away).startswith("the scale of the pressure (t7.AIN0) is wrong")
    both = Stage(rest(pressure=120e3, command=250e3).means, 25e3, settled=False)
    assert said(wiring, rest(), both).startswith("the scale of the output pressure (t7.DAC0) is wrong")


def test_a_limit_on_another_channel_names_that_channel(wiring):
    """A scale of ten times too much crosses the limit of the contraction before the hold is over."""
    tripped = Stage({"displacement": 71e-3}, 100e3, load=10.79, settled=False, tripped="displacement")
    assert said(wiring, rest(), tripped).startswith("the scale of the displacement (t7.AIN1) is wrong")


def test_a_limit_that_trips_before_anything_was_looked_at_names_the_wire(rig):
    """A force 110 N too low is outside its range in the first block, in which no load is known that it would be of."""
    right = rig[2]
    limit = TripRecord("force", None, None, 0.01, "vent", kind="off-range")
    test = SelfTesting(right, lambda _checks: None)
    means = {channel.name: (0.0, 0.0) for channel in right.bench.channels} | {"force": (-110.4, -109.6)}
    test.ended(Outcome("tripped", "", 5, None, None, 0.1, 0, (), means, limit))
    failed, *_ = (check for check in test.checks if check.verdict == FAILED)
    wire = next(f"{c.device}.{c.input}" for c in right.bench.channels if c.name == "force")
    assert f"the force ({wire})" in failed.hint


def test_a_channel_that_falls_silent_accuses_no_wire(rig):
    """What was read last before the silence is old, and no evidence."""
    silent = Trip(TripRecord("pressure", None, None, 0.3, "vent", kind="stale"), 0, 3.0, 0.3)
    checks, failure, _ = self_tested(rig[2], rig[2], Outside(), ends=(3.0, Tripped(silent)))
    assert "no sample" in failure
    assert not [check for check in checks if check.verdict == FAILED]


def test_the_table_has_one_line_a_claim_and_the_cause_once(wiring):
    from pmabench.session.checks import table

    failed = [
        c for c in table(wiring, [rest(), Stage(rest(pressure=50e3, command=25e3).means, 25e3)]) if c.verdict == FAILED
    ]
    assert [check.name for check in failed] == ["pressure follows its command", "pressure against read-back"]
    assert [check.hint == "explained by the same" for check in failed] == [False, True]
