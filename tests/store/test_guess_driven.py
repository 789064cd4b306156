"""Files of a length that is driven at one pressure: the proposed kind, the question of full length, the coefficients.

The files are written here from F = 275 N - 6 N/mm x - 6 N sign x' (ramps) and 6.3 N/mm (sine), with fresh noise.
"""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from pmabench.cli.main import main
from pmabench.store.importers.commands import changes
from pmabench.store.importers.motion import levels


def ramps(cycles=4, speed=1.0, stroke=20.0, rate=50.0):
    """Slow triangles: time [s], contraction [mm], its direction."""
    t = np.arange(0, cycles * 2 * stroke / speed, 1 / rate)
    part = (t * speed / stroke) % 2
    return t, stroke * np.where(part < 1, part, 2 - part), np.where(part < 1, 1.0, -1.0)


def write(path, head, *columns):
    np.savetxt(path, np.column_stack(columns), fmt="%.5f", delimiter=",", header=head, comments="")


def called(*words):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code in (0, 6), result.output
    return result.output


def processed(folder, *answers):
    """The estimates of the one file in a folder, as guess, import and process give them."""
    called("import", folder / "log.csv", "--guess", "-o", folder / "map.yaml", "-q")
    sets = [word for answer in answers for word in ("--set", answer)]
    called("import", folder / "log.csv", "--map", folder / "map.yaml", "--out", folder / "runs", "-q", *sets)
    (run,) = (folder / "runs").iterdir()
    analysis = json.loads(called("process", run, "--out", folder / "analysis", "--json"))["analyses"][0]
    return analysis["kind"], analysis["estimates"]


def holds(found, symbol, truth):
    """Every estimate of a symbol with an interval holds the truth, up to a fifth of its half width; there is one."""
    seen = [e for e in found if e["symbol"] == symbol and e["value"] is not None and e["ci95"]]
    assert seen
    for e in seen:
        low, high = e["ci95"]
        assert low - 0.1 * (high - low) < truth < high + 0.1 * (high - low), e


def test_slow_ramps_of_a_contraction_end_in_the_curve_without_a_question(tmp_path):
    rng = np.random.default_rng(1)
    t, x, way = ramps()
    F = 275 - 6 * x - 6 * way + rng.normal(0, 0.3, len(t))
    write(tmp_path / "log.csv", "t [s],P [bar],x [mm],F [N]", t, 3 + rng.normal(0, 0.002, len(t)),
          x + rng.normal(0, 0.003, len(t)), F)  # fmt: skip
    kind, found = processed(tmp_path)
    assert kind == "isobaric-ramp"
    holds(found, "F_ce", 275.0)
    holds(found, "K", 6000.0)


def test_ramps_at_several_pressures_in_one_file_are_a_trial_each(tmp_path):
    rng, parts, begin = np.random.default_rng(5), [], 0.0
    for P in (150.0, 250.0, 350.0):
        t, x, way = ramps(cycles=3, stroke=0.03 * P)
        rest = np.arange(0, 3, 0.02)
        parts += [(begin + rest, P + 0 * rest, 0 * rest, 0 * rest), (begin + 3 + t, P + 0 * t, x, way)]
        begin += 3 + float(t[-1]) + 0.02
    t, P, x, way = np.concatenate(parts, axis=1)
    F = 1.08 * P - 49 - 6 * x - 6 * way + rng.normal(0, 0.3, len(t))
    write(tmp_path / "log.csv", "t [s],P [kPa],x [mm],F [N]", t, P + rng.normal(0, 0.2, len(t)),
          x + rng.normal(0, 0.003, len(t)), F)  # fmt: skip
    kind, found = processed(tmp_path)
    assert kind == "isobaric-ramp"
    at = {round(e["at"]["pressure"], -4) for e in found if e["symbol"] == "F"}
    assert at == {150e3, 250e3, 350e3}
    for e in found:
        if e["symbol"] == "F" and e["value"] is not None:
            truth = 1.08e-3 * e["at"]["pressure"] - 49 - 6e3 * e["at"]["contraction"]
            assert abs(e["value"] - truth) < 1.0


@pytest.mark.parametrize("head", ["Zeit;Versuch;s_soll;s_ist;p_ist;F_ist", "Zeit;Nr.;Sollweg;Istweg;Istdruck;Zugkraft"])
def test_ramps_that_a_german_log_makes_at_three_pressures_with_pauses_between(tmp_path, head):
    rng, parts = np.random.default_rng(3), []
    for number, P in enumerate((1.5, 2.5, 3.5), 1):
        t, x, way = ramps(cycles=3)
        F = 108 * P - 49 - 6 * x - 6 * way + rng.normal(0, 0.3, len(t))
        p = P + rng.normal(0, 0.002, len(t))
        parts.append((125 * number + t, 0 * t + number, x, x + rng.normal(0, 0.003, len(t)), p, F))
    units = ("s", "", "mm", "mm", "bar", "N")
    names = [f"{name} [{unit}]" if unit else name for name, unit in zip(head.split(";"), units, strict=True)]
    write(tmp_path / "log.csv", ",".join(names), *np.concatenate(parts, axis=1))
    kind, found = processed(tmp_path)
    assert kind == "isobaric-ramp"
    for P in (1.5, 2.5, 3.5):
        here = [e for e in found if round(e["at"]["pressure"], -4) == P * 1e5 and "contraction" not in e["at"]]
        holds(here, "K", 6000.0)
        holds(here, "F_ce", 108 * P - 49)


def test_the_zero_of_a_length_without_a_unit_is_answered_with_its_unit(tmp_path):
    rng = np.random.default_rng(6)
    t, x, way = ramps()
    F = 275 - 6 * x - 6 * way + rng.normal(0, 0.3, len(t))
    write(tmp_path / "log.csv", "Zeit [s],Istdruck [bar],Istweg,Kraft [N]", t, 3 + rng.normal(0, 0.002, len(t)),
          2.0 + (x + rng.normal(0, 0.003, len(t))) / 10, F)  # fmt: skip
    kind, found = processed(tmp_path, "columns.Istweg.unit=cm", "columns.Istweg.contraction.zero=2 cm")
    assert kind == "isobaric-ramp"
    holds(found, "F_ce", 275.0)
    holds(found, "K", 6000.0)


def test_a_length_is_asked_for_its_zero_and_its_sign_follows_from_the_force(tmp_path):
    rng = np.random.default_rng(2)
    t, x, way = ramps()
    F = 275 - 6 * x - 6 * way + rng.normal(0, 0.3, len(t))
    write(tmp_path / "log.csv", "t [s],P [bar],Length [mm],F [lbf]", t, 3 + rng.normal(0, 0.002, len(t)),
          250 - x + rng.normal(0, 0.003, len(t)), F / 4.4482216)  # fmt: skip
    text = called("import", tmp_path / "log.csv", "--guess", "-v")
    assert "reading: falls" in text
    assert "where the muscle has its full length?" in text
    kind, found = processed(tmp_path, "columns.Length [mm].contraction.zero=249 mm")
    assert kind == "isobaric-ramp"
    holds(found, "F_ce", 269.0)  # at 249 mm


def test_a_sine_of_length_is_that_test_and_not_ramps(tmp_path):
    rng = np.random.default_rng(3)
    t = np.arange(0, 20, 0.005)
    x, v = 20 + 8 * np.sin(np.pi * t), 8 * np.pi * np.cos(np.pi * t)
    F = 329 - 6.3 * x - 1.5 * v - 6 * np.sign(v) + rng.normal(0, 0.3, len(t))
    write(tmp_path / "log.csv", "t [s],P [bar],x [mm],F [N]", t, 3.5 + rng.normal(0, 0.003, len(t)),
          x + rng.normal(0, 0.003, len(t)), F)  # fmt: skip
    kind, found = processed(tmp_path, "columns.x [mm].contraction.zero=0 mm")
    assert kind == "sinusoidal-displacement"
    holds(found, "K", 6300.0)
    assert not [e for e in found if e["symbol"] == "F_ce" and e["value"] is not None]


@pytest.mark.parametrize("pressures", [[2.0], [2.0, 3.0]])
def test_sines_that_follow_each_other_in_one_file_are_a_trial_each(tmp_path, pressures):
    """Three frequencies at each pressure, 2 s of rest between them: K 6 N/mm, B 0.9 N s/mm; no pressure before and after."""
    dt, rng, parts = 0.004, np.random.default_rng(6), []
    for P in pressures:
        for f in (0.5, 1.0, 2.0):
            phase = 2 * np.pi * f * np.arange(0, 12.0, dt)
            parts += [
                (P, 10 + 4 * np.sin(phase), 8 * np.pi * f * np.cos(phase)),
                (P, *np.full((2, 500), [[10.0], [0.0]])),
            ]
    at_rest = (0.0, np.full(750, 10.0), np.zeros(750))
    P, x, v = (np.concatenate([np.broadcast_to(part[k], part[1].shape) for part in [at_rest, *parts, at_rest]])
               for k in range(3))  # fmt: skip
    F = np.where(P > 0, 108 * P - 49 - 6 * x - 0.9 * v, 0.0)
    write(tmp_path / "log.csv", "t [s],P [bar],x [mm],F [N]", dt * np.arange(len(x)), P + rng.normal(0, 0.002, len(x)),
          x + rng.normal(0, 0.002, len(x)), F + rng.normal(0, 0.3, len(x)))  # fmt: skip
    kind, found = processed(tmp_path, "columns.x [mm].contraction.zero=0 mm")
    assert kind == "sinusoidal-displacement"
    holds(found, "K", 6000.0)
    holds(found, "B", 900.0)
    assert {(round(e["at"]["pressure"] / 1e5), e["at"]["frequency"]) for e in found if e["at"].get("frequency")} == {
        (round(P), f) for P in pressures for f in (0.5, 1.0, 2.0)
    }


def test_a_contraction_in_percent_is_asked_for_its_length(tmp_path):
    t, x, way = ramps(rate=20.0)
    write(
        tmp_path / "log.csv", "t [s],P [bar],contraction [%],F [N]", t, 3 + 0.001 * way, x / 2.5, 275 - 6 * x - 6 * way
    )
    assert "is a share: of which length?" in called("import", tmp_path / "log.csv", "--guess")


@pytest.mark.parametrize("speed", [0.2, 1.0, 5.0, 50.0])
def test_measured_ramps_are_found_at_any_speed(speed):
    t, x, _ = ramps(cycles=3, speed=speed, rate=max(100.0, 20 * speed))
    x = x + np.random.default_rng(4).normal(0, 0.003, len(t))
    found = changes(t, 1e-3 * x, 0.2e-3, measured=True)
    assert len(found) == 6
    assert all(abs(abs(c.value - c.before) - 0.02) < 0.2e-3 for c in found)
    assert all(c.speed == pytest.approx(1e-3 * speed, rel=0.02) for c in found)


@pytest.mark.parametrize("polled", [1, 5])
@pytest.mark.parametrize("noise", [20.0, 150.0, 400.0, 1000.0])
@pytest.mark.parametrize(("rate", "lag"), [(100, 0.1), (200, 0.3), (50, 0.02)])
def test_a_noisy_pressure_has_the_two_ramps_that_were_made(rate, lag, noise, polled):
    """Of 250 such files with any speed 107 had others: noise and a slow end were ramps of their own."""
    for speed, top, hold in ((9e3, 600e3, 4.0), (23e3, 200e3, 0.8), (76e3, 200e3, 4.2)):
        made = np.cumsum([2.2, top / speed, hold, top / speed, 3.0])
        t = np.arange(0, made[-1], 1 / rate)
        keep = np.exp(-1 / rate / lag)
        P, _ = lfilter([1 - keep], [1, -keep], np.interp(t, [0, *made], [0, 0, top, top, 0, 0]), zi=[0.0])
        P = np.round((P + np.random.default_rng(rate).normal(0, noise, len(t))) / 100) * 100
        found = changes(t, P[np.arange(len(t)) // polled * polled], 1e3, measured=True)
        assert [c.value > c.before for c in found] == [True, False]
        assert [c.t for c in found] == pytest.approx(made[[0, 2]], abs=0.3 + 0.05 * top / speed + 2 * lag)
        assert found[0].value == pytest.approx(top, abs=0.05 * top + 4 * noise)


def test_levels_of_a_slow_log_step_from_one_sample_to_the_next():
    t = np.arange(0, 60, 0.5)
    P = 1e5 * (1 + t // 12) + np.random.default_rng(6).normal(0, 200, len(t))
    found = levels(t, P, 5e4)
    assert [round(one.t) for one in found] == [12, 24, 36, 48]
    assert all(one.value - one.before == pytest.approx(1e5, rel=0.01) for one in found)


@pytest.mark.parametrize("lengths", [(0.0, 6.0, 12.0), (0.0, 0.0, 10.0, 10.0)])
def test_slow_ramps_of_pressure_at_lengths_that_are_held_are_no_sine(tmp_path, lengths):
    """F = (2.4 - 0.06 x) P - 20, 8 N between filling and emptying; x in mm, P in kPa. A triangle is nearly a sine."""
    random = np.random.default_rng(11)
    t = np.arange(0.0, 120.0, 0.02)
    P = np.interp(t, [5.0, 55.0, 60.0, 110.0], [0.0, 500.0, 500.0, 0.0])
    way = np.where((t > 5) & (t < 58), -4.0, np.where((t >= 58) & (t < 110), 4.0, 0.0))
    columns = []
    for number, x in enumerate(lengths):
        F = np.maximum((2.4 - 0.06 * x) * P - 20.0 + way, 0.0) + random.normal(0, 0.2, len(t))
        held = x + random.normal(0, 0.005, len(t))
        columns.append([t + 120.0 * number, P + random.normal(0, 0.5, len(t)), held, F])
    write(tmp_path / "log.csv", "t [s],p [kPa],x [mm],F [N]", *np.hstack(columns))
    kind, found = processed(tmp_path)
    assert kind == "isometric-pressurisation"
    slopes = {round(e["at"]["contraction"] * 1e3): e for e in found if e["symbol"] == "m"}
    assert set(slopes) == {round(x) for x in lengths}
    for x, one in slopes.items():
        assert one["value"] == pytest.approx((2.4 - 0.06 * x) * 1e-3, rel=2e-3)


def test_a_map_that_takes_noise_for_ramps_gives_no_number_and_no_error_of_the_program(tmp_path):
    random = np.random.default_rng(2)
    t, x, way = ramps()
    P, F = 300 + random.normal(0, 0.2, len(t)), 275 - 6 * x - 6 * way + random.normal(0, 0.3, len(t))
    write(tmp_path / "log.csv", "t [s],p [kPa],x [mm],F [N]", t, P, x, F)
    called("import", tmp_path / "log.csv", "--guess", "-o", tmp_path / "map.yaml", "-q")
    text = (tmp_path / "map.yaml").read_text().replace("kind: isobaric-ramp", "kind: isometric-pressurisation")
    (tmp_path / "map.yaml").write_text(text.replace("trials: {by: file}", "trials: {by: ramp, smallest: 0.5 kPa}"))
    called("import", tmp_path / "log.csv", "--map", tmp_path / "map.yaml", "--out", tmp_path / "runs", "-q")
    (run,) = (tmp_path / "runs").iterdir()
    analysis = json.loads(called("process", run, "--out", tmp_path / "analysis", "--json"))["analyses"][0]
    assert not [e for e in analysis["estimates"] if e["value"] is not None]
    assert any("straight part" in found["text"] for found in analysis["findings"])
