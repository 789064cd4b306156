"""Faults that one file shows by itself are reported; clean recordings raise none."""

import numpy as np
import pytest

from pmabench.store.importers.found import Checked
from pmabench.store.importers.magnitude import Muscle, area_factor
from pmabench.store.importers.map_rules import ColumnRule
from pmabench.store.importers.plausible import judge, stopped
from pmabench.store.importers.quality import inspect
from pmabench.store.records import UNUSABLE
from tests.store.plausible_files import damaged, isometric, sines, squares, stairs, steps

COLUMNS = (
    ("pressure", "P (kPa)", "kPa", 1e3),
    ("force", "F", "N", 1.0),
    ("displacement", "x (mm)", "mm", 1e-3),
    ("pressure_command", "set (kPa)", "kPa", 1e3),
)


def look(file, bore=None, contraction=None, confirmed=(), columns=COLUMNS):
    """Flags, findings by kind and questions of a file."""
    values = {"pressure": file.pressure, "force": file.force, "displacement": file.displacement}
    values["pressure_command"] = file.command
    channels = [
        Checked(ColumnRule(name, role, unit, slope, 0.0), values[role], values[role] * slope)
        for role, name, unit, slope in columns
        if values[role] is not None
    ]
    period = float(np.median(np.diff(file.t)))
    flags, found = inspect(file.t, channels, (0.5 / period, 2.0 / period), 4 * period, 60.0)
    held = file.kind == "isometric"
    flags, still = stopped(file.t, channels, flags, held=held)
    muscle = Muscle(bore and bore * 1e-3, 0.3, contraction, held, not held)
    more, questions = judge(file.t, channels, flags, muscle, confirmed)
    return flags, {each.kind: each for each in found + still + more}, questions


CLEAN = (
    lambda seed: isometric(seed, rate=(25.0, 100.0, 300.0)[seed % 3], cycles=1 + seed % 5),
    lambda seed: isometric(seed, rate=100.0, counts=(200, 1000)[seed % 2]),
    lambda seed: steps(seed, rate=100.0, counts=bool(seed % 8 < 4)),
    lambda seed: sines(seed, rate=100.0),
    lambda seed: stairs(seed, rate=(10.0, 50.0, 100.0)[seed % 3]),
    lambda seed: squares(seed, rate=(1.0, 10.0, 100.0)[seed % 4 % 3]),
)


@pytest.mark.parametrize("begin", [0, 25, 50, 75])
def test_of_100_clean_recordings_none_raises_a_finding(begin):
    for seed in range(begin, begin + 25):
        file = CLEAN[seed % len(CLEAN)](seed)
        bore = file.truth.get("bore") if seed % 3 else None
        flags, found, questions = look(file, bore, 0.0)
        assert not flags.any(), (seed, found)
        assert set(found) <= {"size"}, (seed, found)
        assert all(each.level == "note" for each in found.values())
        assert not questions, (seed, questions)


def put(values, where, what):
    values = values.copy()
    values[where] = what
    return values


def rising(file):
    """Row at which the pressure first passes half of its peak."""
    return int(np.argmax(file.pressure > 0.5 * file.pressure.max()))


EXCLUDED = {
    "five rows of 9999": ("sentinel", lambda f, n, r: put(f, slice(n // 4, n // 4 + 5), 9999.0)),
    "9999 here and there": ("sentinel", lambda f, n, r: put(f, np.linspace(50, n - 50, 5).astype(int), 9999.0)),
    "every 50th row +9999 or -9999": (
        "sentinel",
        lambda f, n, r: put(f, np.arange(25, n, 50), 9999.0 * (-1.0) ** np.arange(len(np.arange(25, n, 50)))),
    ),
    "-999.25": ("sentinel", lambda f, n, r: put(f, slice(r, r + 8), -999.25)),
    "full scale of a converter": ("sentinel", lambda f, n, r: put(f, slice(r, r + 30), 32767.0)),
    "1e10": ("sentinel", lambda f, n, r: put(f, [100, n - 100], 1e10)),
    "a burst of numbers": ("burst", lambda f, n, r: put(f, slice(r, r + 4), f.max() * np.array([4.1, 5.3, 3.9, 4.4]))),
    "20 rows of 0": ("held", lambda f, n, r: put(f, slice(r, r + 20), 0.0)),
    "0 in every 20th row": ("sentinel", lambda f, n, r: put(f, np.arange(r, r + 300, 20), 0.0)),
    "spikes of 30 % in every 40th row": ("spike", lambda f, n, r: f + (np.arange(n) % 40 == 7) * 0.3 * f.max()),
    "frozen for 2 s": ("frozen", lambda f, n, r: put(f, slice(r, r + 200), f[r])),
    "frozen to the end": ("frozen", lambda f, n, r: put(f, slice(r, n), f[r])),
    "clipped": ("clipped", lambda f, n, r: np.minimum(f, round(0.8 * f.max(), 3))),
}


@pytest.mark.parametrize("name", EXCLUDED)
@pytest.mark.parametrize("counts", [None, 1000])
def test_readings_that_are_none_are_left_out(name, counts):
    kind, damage = EXCLUDED[name]
    file = isometric(1, counts=counts)
    bad = damaged(file, force=damage(file.force, len(file.t), rising(file)))
    flags, found, _ = look(bad)
    wrong = np.flatnonzero(bad.force != file.force)
    unusable = (flags & np.uint16(UNUSABLE)) != 0
    assert kind in found
    assert unusable[wrong].mean() > 0.98, "damaged rows stay in"
    assert unusable.sum() <= len(wrong) + 10, "good rows are left out"
    assert not [each for each in found.values() if each.withholds], "what is left out withholds nothing"
    one = found[kind]
    assert one.index is not None
    assert one.t == pytest.approx(file.t[one.index])
    without = np.polyfit(bad.pressure[~unusable], bad.force[~unusable], 1)[0]
    assert without == pytest.approx(np.polyfit(file.pressure[~unusable], file.force[~unusable], 1)[0], rel=1e-9)


def later(values, rows):
    return np.concatenate([np.full(rows, values[0]), values[:-rows]]) + np.random.default_rng(0).normal(
        0, 0.001 * np.ptp(values), len(values)
    )


def exchanged(file, begin, end):
    here = (np.arange(len(file.t)) >= begin) & (np.arange(len(file.t)) < end)
    return damaged(
        file, force=np.where(here, file.pressure, file.force), pressure=np.where(here, file.force, file.pressure)
    )


def from_row(file, factor=1.0, offset=0.0):
    return np.where(np.arange(len(file.t)) < rising(file), file.force, factor * file.force + offset * file.force.max())


WITHHELD = {
    "force 1 s late": ("lag", lambda f: damaged(f, force=later(f.force, 100))),
    "pressure 1 s late": ("lag", lambda f: damaged(f, pressure=later(f.pressure, 100))),
    "gain changed by 20 %": ("jump", lambda f: damaged(f, force=from_row(f, 1.2))),
    "gain changed by 10": ("jump", lambda f: damaged(f, force=from_row(f, 10.0))),
    "zero changed by 10 %": ("jump", lambda f: damaged(f, force=from_row(f, 1.0, 0.1))),
    "gain of pressure changed": (
        "jump",
        lambda f: damaged(f, pressure=np.where(np.arange(len(f.t)) < rising(f), f.pressure, 1.2 * f.pressure)),
    ),
    "columns exchanged to the end": ("swap", lambda f: exchanged(f, rising(f), len(f.t))),
    "columns exchanged for 100 rows": ("swap", lambda f: exchanged(f, rising(f), rising(f) + 100)),
    "bar called kPa": ("magnitude", lambda f: damaged(f, pressure=f.pressure / 100.0)),
    "Pa called kPa": ("magnitude", lambda f: damaged(f, pressure=f.pressure * 1000.0)),
    "pulling read as negative": ("magnitude", lambda f: damaged(f, force=-f.force)),
    "kN called N": ("magnitude", lambda f: damaged(f, force=f.force / 1000.0)),
    "counts called newtons": ("counts", lambda f: damaged(f, force=np.round(f.force / f.force.max() * 900.0))),
}


@pytest.mark.parametrize("name", WITHHELD)
def test_what_no_rule_can_set_right_withholds_and_can_be_confirmed(name):
    kind, damage = WITHHELD[name]
    file = damage(isometric(1))
    _, found, _ = look(file, contraction=0.0)
    assert found[kind].withholds, found
    assert found[kind].level == "fault"
    _, found, _ = look(file, contraction=0.0, confirmed=(kind,))
    assert found[kind].level == "note"
    assert not found[kind].withholds
    assert "confirmed in the map" in found[kind].text


def test_columns_that_cross_where_they_exchange_turn_their_slope():
    file = isometric(35)
    assert abs(file.pressure - file.force)[rising(file)] < 0.02 * file.force.max(), "nothing leaps"
    _, found, _ = look(exchanged(file, rising(file), len(file.t)))
    assert found["swap"].withholds


def test_a_gain_that_changes_between_cycles_is_found_by_their_slopes():
    file = isometric(4, cycles=6)
    empty = np.flatnonzero((file.pressure < 5.0) & (file.force < 0.02 * file.force.max()))
    begin = int(empty[len(empty) // 2])
    _, found, _ = look(damaged(file, force=np.where(np.arange(len(file.t)) < begin, file.force, 1.15 * file.force)))
    assert found["gain"].withholds
    assert "+15" in found["gain"].text


@pytest.mark.parametrize("factor", [1.0 / 6.894757, 1.0 / 9.80665])
def test_the_bore_decides_between_units(factor):
    file = isometric(1)
    psi = factor > 0.12
    bad = damaged(file, pressure=file.pressure * factor) if psi else damaged(file, force=file.force * factor)
    _, found, _ = look(bad, bore=file.truth["bore"], contraction=0.0)
    assert found["magnitude"].withholds
    assert ("psi" if psi else "is the force in kg") in found["magnitude"].text


def test_psi_called_kpa_is_a_question_where_nothing_decides_it():
    file = isometric(1)
    bad = damaged(file, pressure=file.pressure / 6.894757)
    _, found, (question,) = look(bad)
    assert "magnitude" not in found
    assert (question.where, question.used) == ("P (kPa)", "kPa")
    assert "psi" in question.question
    assert look(bad, confirmed=("pressure-unit",))[2] == []


def test_mpa_called_bar_is_a_question():
    file = isometric(1)
    bar = tuple(("pressure", "P (bar)", "bar", 1e5) if role == "pressure" else (role, *rest) for role, *rest in COLUMNS)
    _, _, (question,) = look(damaged(file, pressure=file.pressure / 1000.0), columns=bar)
    assert "in MPa" in question.question
    assert look(damaged(file, pressure=file.pressure / 100.0), columns=bar)[2] == []


def test_seconds_called_ms_are_a_question():
    file = isometric(1, rate=500.0)
    _, _, (question,) = look(damaged(file, t=file.t / 1000.0))
    assert question.what == "time-unit"
    assert look(damaged(file, t=file.t / 1000.0), confirmed=("time-unit",))[2] == []


def test_whole_newtons_are_a_question_where_the_file_itself_names_the_unit():
    file = isometric(1)
    whole = damaged(file, force=np.round(file.force / file.force.max() * 900.0))
    named = tuple(("force", "F (N)", "N", 1.0) if role == "force" else (role, *rest) for role, *rest in COLUMNS)
    _, found, (question,) = look(whole, columns=named)
    assert "counts" not in found
    assert (question.what, question.where) == ("counts", "F (N)")
    assert look(whole, columns=named, confirmed=("counts",))[2] == []


def test_an_absolute_pressure_is_a_question():
    file = isometric(1)
    for air in (90.0, 101.3, 103.0):
        (question,) = look(damaged(file, pressure=file.pressure + air))[2]
        assert question.what == "absolute"
    assert look(damaged(file, pressure=file.pressure + 101.3), confirmed=("absolute",))[2] == []


@pytest.mark.parametrize("factor", [1e3, 1e-5])
def test_a_length_in_a_unit_that_cannot_be_is_a_question(factor):
    """Metres called mm, and micrometres called mm."""
    file = steps(1)
    wrong = damaged(file, displacement=file.displacement * factor)
    (question,) = look(wrong)[2]
    assert (question.what, question.where) == ("length-unit", "x (mm)")
    assert look(wrong, confirmed=("length-unit",))[2] == []


def test_a_length_that_is_only_set_may_stay_at_0():
    file = isometric(1)
    rest = 1e-2 * np.random.default_rng(1).standard_normal(len(file.t))
    assert look(damaged(file, displacement=rest))[2] == []
    (question,) = look(damaged(file, displacement=rest + 4e3))[2]
    assert question.what == "length-unit", "4 mm called m"


def test_a_command_in_a_unit_that_cannot_be_withholds():
    file = steps(1)
    _, found, _ = look(damaged(file, command=file.command / 100.0))
    assert found["magnitude"].withholds
    assert found["magnitude"].channel == "pressure_command"


def test_the_factors_of_chou_and_hannaford():
    assert area_factor(np.rad2deg(np.arccos(1 / np.sqrt(3)))) == pytest.approx(0.0, abs=1e-12), "54.7 deg pulls nothing"
    assert area_factor(45.0) == pytest.approx(1.0)
