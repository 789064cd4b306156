"""Calibration: errors of the simulated sensors are found within the stated uncertainty; files are new, never changed."""

from dataclasses import replace
from datetime import date
from types import SimpleNamespace

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile, RecordError, UsageError, VerdictFailed
from pmabench.bench.channels import read_calibration
from pmabench.bench.interface import Scale
from pmabench.engine.operator import ConfirmedBeforehand, Nobody
from pmabench.session import calibration
from pmabench.session.calibration import Request, calibrate, not_followed, not_shown, uncovered
from pmabench.session.calibration_line import DOWN, UP, Point, budget, fit, write_calibration
from pmabench.store.reader import open_run
from tests.engine.benches import mounted

FORCE = tuple(9.81 * mass for mass in (0.0, 1.1, 6.0, 16.0, 26.0))
CASES = {
    "force": ("mock", Request("force", FORCE, "weights", 0.02, hold=400e3), 2.5, "length"),
    "pressure": ("mock", Request("pressure", (0.0, 150e3, 300e3, 450e3, 600e3), "gauge", 200.0), 4e3, "pressure"),
    "displacement": (
        "mock-actuator",
        Request("displacement", (0.0, 10e-3, 20e-3, 30e-3), "blocks", 4e-6),
        0.3e-3,
        "length",
    ),
}


def truth(text, nominal, wait):
    """Who reads a perfect reference: the weights, the regulator and the drive of the simulation are exact."""
    return nominal


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", CASES)
def test_slope_and_offset_errors_are_recovered_within_the_stated_uncertainty(name, seed):
    bench, request, spread, _ = CASES[name]
    random = np.random.default_rng(seed)
    factor, offset = float(random.uniform(0.97, 1.03)), float(random.uniform(-spread, spread))
    made = mounted(bench, seed=seed, errors={name: {"factor": factor, "offset": offset}})
    old = next(c for c in made.bench.channels if c.name == name).scale
    done = calibrate(made, request, ConfirmedBeforehand(), truth, None)
    assert done.outcome.exit_code == 0, done.outcome.why
    span = max(request.points)
    for true in np.linspace(0, span, 9):
        raw = old.to_raw(factor * true + offset)  # what the sensor gives
        assert abs(done.fit.scale.to_si(raw) - true) <= done.fit.expanded
    assert done.fit.expanded < 0.005 * span  # and it says something
    wrong = abs(factor * span + offset - span)
    assert wrong > done.fit.expanded or seed  # the old line would have failed


def test_regulator_command_to_pressure_is_held_against_the_calibrated_channel():
    """The output takes 65.535 counts for 1 kPa; the pressure channel is known to 1.5 kPa and 0.2 %."""
    request = Request("pressure_command", (0.0, 200e3, 400e3, 600e3), "channel pressure", 0.0)
    done = calibrate(mounted("mock"), request, Nobody(), truth, None)
    assert done.fit.scale.slope == pytest.approx(1e6 / 65535, rel=1e-3)
    assert done.raw_unit == "count"
    assert done.fit.reference == pytest.approx(1500.0 + 0.002 * 600e3)
    assert done.fit.expanded >= done.fit.reference


def points(ways, f, cycles=2, noise=0.0, seed=0):
    random = np.random.default_rng(seed)
    return [
        Point(x, x, f(x, way, cycle) + noise * random.standard_normal(), way, cycle)
        for cycle in range(cycles)
        for way in ways
        for x in (np.arange(5.0) if way == UP else np.arange(5.0)[::-1])
    ]


def test_each_part_of_the_uncertainty_alone():
    """raw = 2 x + 1: 0.5 per count; each part is given exactly."""
    line = lambda x, way, cycle: 2 * x + 1  # noqa: E731
    exact = fit(points((UP, DOWN), line), 0.3)
    assert (exact.scale.slope, exact.scale.offset) == pytest.approx((0.5, -0.5))
    assert exact.expanded == pytest.approx(0.3)
    loop = fit(points((UP, DOWN), lambda x, way, cycle: line(x, way, cycle) + (0.1 if way == UP else -0.1)), 0.0)
    assert loop.hysteresis == pytest.approx(0.1)  # 0.2 counts
    assert loop.expanded == pytest.approx(2 * 0.1 / 2 / 3**0.5)
    bent = fit(points((UP, DOWN), lambda x, way, cycle: line(x, way, cycle) + 0.02 * (x - 2) ** 2), 0.0)
    assert bent.residual == pytest.approx(0.02, rel=0.05)  # of 0.02 (x-2)^2 a line leaves at most 0.04 counts
    assert bent.expanded == pytest.approx(2 * bent.residual / 3**0.5, rel=1e-6)
    shift = fit(points((UP, DOWN), lambda x, way, cycle: line(x, way, cycle) + 0.2 * cycle), 0.0)
    assert shift.drift == pytest.approx(0.1)
    assert shift.repeatability == pytest.approx(0.1 / 2**0.5)


def test_repeatability_is_the_scatter_between_cycles():
    found = fit(points((UP, DOWN), lambda x, way, cycle: 2 * x, cycles=200, noise=0.04), 0.0)
    assert found.repeatability == pytest.approx(0.02, rel=0.05)


def sensor(places, cycles, noise, seed, off=lambda v: 0.0):
    """Readings [count] of a sensor of 500 N full scale that is `off` by so much, with scatter between readings [N]."""
    random = np.random.default_rng(seed)
    ways = ((UP, places), (DOWN, places[::-1]))
    return [
        Point(v, v, v + off(v) + noise * random.standard_normal(), way, cycle)
        for cycle in range(cycles)
        for way, series in ways
        for v in series
    ]


def test_two_points_do_not_say_that_a_sensor_is_straight(tmp_path):
    """4 bow v/w (1 - v/w) is off by 2 N in the middle; +- 0.1 N was written, a twentieth of it."""
    bow = lambda v: 8.0 * v / 500 * (1 - v / 500)  # noqa: E731
    found = fit(sensor((0.0, 500.0), 2, 0.05, 0, bow), 0.1)
    assert found.residual is None
    path = write_calibration(tmp_path, "force", "force", "count", found, reference="w", run="r", today=date(2026, 1, 2))
    with pytest.raises(InvalidFile, match=r"FORCE-20260102\.yaml:8.*no reading with a unit"):
        read_calibration(path, "force")  # nobody has said it yet
    path.write_text(path.read_text().replace("??", "2.5 N"))
    assert read_calibration(path, "force").record.offset_uncertainty == 2.5
    three = fit(sensor((0.0, 250.0, 500.0), 2, 0.05, 0, bow), 0.1)
    off = [abs(three.scale.to_si(v + bow(v)) - v) for v in np.linspace(0, 500, 101)]
    assert max(off) < three.expanded < 1.3 * max(off)


@pytest.mark.parametrize(
    ("reads", "said", "lost"),
    [
        (lambda nominal: nominal, [], False),
        (lambda nominal: nominal and nominal + 10.8, ["by the calibration in use", "off the line"], False),
        (lambda nominal: nominal * 1.06, ["by the calibration in use"], False),
        (lambda nominal: nominal + 49.05 * (nominal == FORCE[3]), ["by the calibration in use", "off the line"], True),
    ],
    ids=["right", "a hanger that was forgotten", "marks in another unit", "a plate too many at one point"],
)
def test_a_reference_that_is_not_what_was_entered_is_said(reads, said, lost):
    """The new line was compared with nothing: 10.8 N off within 0.107 N."""
    request = replace(CASES["force"][1], points=FORCE)
    made = mounted("mock", seed=1)
    done = calibrate(made, request, ConfirmedBeforehand(), lambda _text, nominal, _wait: reads(nominal), None)
    assert len(done.warnings) == len(said)
    assert all(words in text for words, text in zip(said, done.warnings, strict=True))
    assert (done.fit is None) == lost
    assert ("no calibration: the point 206 N lies" in done.outcome.why) == lost


def test_yes_is_refused_on_a_real_bench_before_anything_is_filled(monkeypatch):
    """It was refused after the proof test of the vent path."""
    hooks = {}
    monkeypatch.setattr(calibration, "guided_run", lambda *_, **more: hooks.update(more))
    calibrate(mounted("mock"), replace(CASES["pressure"][1], nominal=True), ConfirmedBeforehand(), truth, None)
    hooks["before_proof"](SimpleNamespace(bench=SimpleNamespace(simulated=True)))
    with pytest.raises(UsageError, match="somebody has to read the reference"):
        hooks["before_proof"](SimpleNamespace(bench=SimpleNamespace(simulated=False)))


def test_progress_is_the_share_of_points_that_are_read():
    seen = []
    request = replace(CASES["force"][1], points=FORCE)
    calibrate(mounted("mock"), request, ConfirmedBeforehand(), truth, None, progress=seen.append)
    shares = [one.t / (one.t + one.longest) for one in seen]
    assert shares == pytest.approx([number / 20 for number in range(20)])


@pytest.mark.parametrize("error", ["of each weight", "of one share"])
def test_the_gain_is_known_as_well_as_the_weights_tell_it(tmp_path, error):
    """Weights known to 0.5 N (k = 2): the slope errs within gain_uncertainty; none was written, and K had no force part."""
    places, slopes = np.array([0.0, 100.0, 250.0, 500.0]), []
    for seed in range(300):
        random = np.random.default_rng(seed)
        off = random.normal(0.0, 0.25, 4) if error == "of each weight" else random.normal(0.0, 0.25) * places / 500.0
        points = [
            Point(v, v, v + e, way, c) for v, e in zip(places, off, strict=True) for way in (UP, DOWN) for c in (0, 1)
        ]
        slopes.append(abs(fit(points, 0.5).scale.slope - 1.0))
    exact = fit([Point(v, v, v, way, c) for v in places for way in (UP, DOWN) for c in (0, 1)], 0.5)
    path = write_calibration(tmp_path, "force", "force", "count", exact, reference="w", run="r", today=date(2026, 1, 2))
    gain = read_calibration(path, "force").record.gain_uncertainty
    assert gain == pytest.approx(2**0.5 * 0.5 / 500.0, rel=0.01)
    assert np.mean(np.array(slopes) <= gain) >= 0.93


def test_one_cycle_does_not_say_that_readings_repeat():
    """Scatter of 1 N at 0 and 500 N: the line is off by more than U in 1 of 4 single cycles, where 0 N counted."""
    beyond, repeats = [], []
    for seed in range(400):
        found = fit(sensor((0.0, 500.0), 1, 1.0, seed), 0.1)
        beyond.append(abs(found.scale.to_si(500.0) - 500.0) > found.expanded)
        repeats.append(found.repeatability**2)
    assert np.mean(repeats) ** 0.5 == pytest.approx(1.0, rel=0.1)
    assert np.mean(beyond) < 0.08
    loop = fit([Point(v, v, v + d, w, 0) for v, d, w in ((0, 0, UP), (9, 0, UP), (9, 0, DOWN), (0, 0.3, DOWN))], 0.0)
    assert loop.drift == pytest.approx(0.3, rel=0.1)  # of the first point, from its first reading to its last


def test_what_few_points_and_cycles_do_not_show_is_said_before():
    first_words = {(2, 1): ["two points", "one cycle"], (3, 2): ["three points"], (4, 2): []}
    for (count, cycles), words in first_words.items():
        request = Request("force", tuple(map(float, range(count))), "w", 0.1, cycles)
        assert [" ".join(line.split()[:2]) for line in not_shown(request)] == words


def test_a_point_typed_thrice_shows_no_bend_and_no_uncertainty():
    (said,) = not_shown(Request("force", (0.0, 9.0, 9.0, 9.0), "w", 0.1, 2))
    assert said.startswith("two different points"), "four were typed"
    line = fit(sensor((0.0, 9.0, 9.0, 9.0), 2, 0.1, 1), 0.1)
    assert dict(budget(line, "force", "V"))["expanded (k = 2)"].startswith("not known")


def test_points_that_leave_most_of_the_range_out_are_warned_of():
    """A sensor bent by 0.2 mm, calibrated at 0, 10, 20 and 100 mm, was twice U off its line between the last two."""
    points = (0.0, 0.01, 0.02, 0.1)
    (said,) = not_shown(Request("displacement", points, "w", 2e-5, 2))
    assert "between 20 mm and 100 mm" in said
    bent = [
        Point(x, x, x + 2e-4 * np.sin(2 * np.pi * x / 0.1), way, n)
        for n in (0, 1)
        for way in (UP, DOWN)
        for x in points
    ]
    line, x = fit(bent, 2e-5), np.linspace(0, 0.1, 101)
    assert np.abs(line.scale.to_si(x + 2e-4 * np.sin(2 * np.pi * x / 0.1)) - x).max() > 1.5 * line.expanded
    assert not not_shown(Request("displacement", (0.0, 0.03, 0.06, 0.1), "w", 2e-5, 2))


def test_a_cell_that_sees_no_load_is_no_calibration(tmp_path):
    """496 N on a support: the reading moved by 0.1 count of 65535, and a file with 3483 N/count was written."""
    request = Request("force", (0.0, 496.386), "weights", 0.1, cycles=1)
    done = calibrate(mounted("mock"), request, ConfirmedBeforehand(), truth, tmp_path)
    assert (done.outcome.exit_code, done.fit) == (6, None)
    assert "no calibration: the reference changes by 496" in done.outcome.why
    assert "rest on their support (--hold lifts them)" in done.outcome.why
    pressure = [replace(p, noise=10.0) for p in sensor((0.0, 400e5), 2, 0.0, 0, lambda v: 0.01 * v - v)]
    said = not_followed(replace(fit(pressure, 0.1), expanded=3e7), pressure, "pressure", "count")
    assert "loads" not in said
    assert "typed in its unit" in said
    by_chance = [replace(p, noise=10.0) for p in sensor((0.0, 496.0), 2, 0.0, 0, lambda v: 0.14 * v / 496 - v)]
    assert "does not follow" in not_followed(fit(by_chance, 0.1), by_chance, "force", "count")
    good = [replace(p, noise=10.0) for p in sensor((0.0, 496.0), 2, 0.1, 0)]
    assert not_followed(fit(good, 0.1), good, "force", "count") == ""


def test_readings_far_apart_at_one_nominal_pressure_are_points_of_their_own():
    """A valve stuck at 330 kPa on the way down: 50 and 330 kPa became one point at 190 kPa, and 400 kPa was none."""
    up, down = (50e3, 200e3, 400e3), (400e3, 200e3, 50e3)
    stuck = [Point(v, v, v / 100, UP, 0) for v in up] + [Point(v, 330e3, 3300.0, DOWN, 0) for v in down]
    found = fit(stuck, 100.0)
    assert sorted(value for _, value in found.points) == pytest.approx([50e3, 200e3, 330e3, 330e3, 330e3, 400e3])
    near = [Point(v, v + off, (v + off) / 100, way, 0) for way, off in ((UP, 0.0), (DOWN, 30e3)) for v in up]
    assert [value for _, value in fit(near, 100.0).points] == pytest.approx([65e3, 215e3, 415e3])


def test_a_pressure_that_was_not_reached_is_reported():
    reads = iter((50e3, 200e3, 400e3, 330e3, 330e3, 330e3))
    request = Request("pressure", (50e3, 200e3, 400e3), "gauge", 1e3, cycles=1)
    done = calibrate(mounted("mock"), request, ConfirmedBeforehand(), lambda *_: next(reads), None)
    said = [f"pressure not reached: 330 kPa of {asked} kPa (down, cycle 1)" for asked in (400, 200, 50)]
    assert [text.partition(": the line")[0] for text in done.warnings] == said
    good = calibrate(mounted("mock"), request, ConfirmedBeforehand(), truth, None)
    assert good.warnings == ()


def test_readings_that_do_not_change_are_no_calibration():
    with pytest.raises(VerdictFailed, match="make no line"):
        fit(points((UP,), lambda x, way, cycle: 3.0), 0.1)


def test_the_file_is_what_a_bench_reads_and_is_never_written_over(tmp_path):
    found = fit(points((UP, DOWN), lambda x, way, cycle: 200 * x + 10, noise=1.0), 0.01)
    about = {"reference": 'cell "7", no. 3: ok', "run": "20261121-x", "today": date(2026, 11, 21)}
    first = write_calibration(tmp_path / "c", "force", "force", "count", found, **about)
    second = write_calibration(
        tmp_path / "c", "force", "force", "count", found, valid_until=date(2027, 11, 21), **about
    )
    assert (first.stem, second.stem) == ("FORCE-20261121", "FORCE-20261121-2")
    read = read_calibration(second, "force")
    assert read.scale.slope == pytest.approx(found.scale.slope, rel=1e-6)
    assert read.scale.offset == pytest.approx(found.scale.offset, rel=1e-6, abs=1e-9)
    assert read.record.offset_uncertainty >= found.expanded * (1 - 1e-9)
    assert (read.record.reference, read.record.valid_until, read.raw_unit) == (
        about["reference"],
        "2027-11-21",
        "count",
    )


def test_a_folder_that_cannot_be_written_is_a_sentence(tmp_path):
    (tmp_path / "c").write_text("a file")
    found = fit(points((UP, DOWN), lambda x, way, cycle: 200 * x), 0.01)
    with pytest.raises(RecordError, match="cannot be written"):
        write_calibration(
            tmp_path / "c", "force", "force", "count", found, reference="", run="", today=date(2026, 11, 21)
        )


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (Request("temperature", (0.0, 1.0), "", 0.0), "cannot be calibrated"),
        (Request("pressure", (0.0, 700e3), "", 0.0), "outside what may be commanded"),
        (Request("force", (0.0, 50.0), "", 0.0), "cannot be made of"),
        (Request("pressure", (1e5,), "", 0.0), "at least two"),
        (Request("pressure", (0.0, 1e5), "", 0.0, hold=1e5), "belongs to the force"),
        (Request("pressure", (0.0, 1e5), "", 0.0, cycles=0), "cycles"),
    ],
)
def test_what_cannot_be_calibrated_is_said_before_anything_moves(request_, said):
    with pytest.raises(UsageError, match=said):
        calibrate(mounted("mock"), request_, Nobody(), truth, None)


def test_the_record_of_a_calibration_holds_every_point(tmp_path):
    request = Request("pressure", (0.0, 100e3), "gauge 7", 100.0, cycles=1)
    done = calibrate(mounted("mock"), request, Nobody(), truth, tmp_path)
    run = open_run(done.outcome.folder)
    assert (run.kind, run.status) == ("calibration", "finished")
    found = [event.data for event in run.events if event.kind == "calibration-point"]
    assert [(p["target"], p["way"]) for p in found] == [(0.0, UP), (1e5, UP), (1e5, DOWN), (0.0, DOWN)]
    (last,) = [event.data for event in run.events if event.kind == "calibrated"]
    assert Scale(**last["scale"]) == done.fit.scale


def test_what_a_bench_will_make_of_trips_beyond_the_points_is_reported_before():
    """The regulator reaches its command limit, 600 kPa; trips at 650 and -30 kPa. Loads to 255 N, and a trip at 1900 N."""
    at_pressure = uncovered(mounted("mock"), CASES["pressure"][1])
    assert len(at_pressure) == 2
    assert all("a bench takes it" in line for line in at_pressure)
    [at_force] = uncovered(mounted("mock"), CASES["force"][1])
    assert "a bench refuses a calibration that ends so far from it; take points from 0 N at least to 1520 N" in at_force
