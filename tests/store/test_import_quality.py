"""Each fault that real files have is flagged and told where it is, and nothing is changed (promise R5)."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.store.importers.found import Checked, Summary
from pmabench.store.importers.importing import compare
from pmabench.store.importers.map_rules import ColumnRule
from pmabench.store.importers.quality import against_sign, inspect
from pmabench.store.records import Flag

RATE = (80.0, 180.0)


def clean(n=500):
    rng = np.random.default_rng(1)
    return np.arange(n) * 0.01, 8.0 + np.sin(np.arange(n) * 0.05) + rng.normal(0, 0.01, n)


def look(t, raw, gap=0.05, leap=60.0, **rule):
    t, raw = np.asarray(t, dtype=float), np.asarray(raw, dtype=float)
    kept = t.copy(), raw.copy()
    channel = ColumnRule("Piezo_P_(mA)", "pressure", "mA", 75e3, -300e3, **rule)
    flags, found = inspect(t, [Checked(channel, raw, raw * 75e3 - 300e3)], RATE, gap, leap)
    assert np.array_equal(kept[0], t)
    assert np.array_equal(kept[1], raw, equal_nan=True)
    return flags, {finding.kind: finding for finding in found}


def flagged(flags, flag):
    return np.flatnonzero(flags & np.uint16(flag)).tolist()


def test_a_clean_record_has_no_flag():
    flags, found = look(*clean(), dropout=0.0, stale_after=0.5, low=0.0, high=700e3)
    assert not flags.any()
    assert not found


def test_a_cut_wire_is_a_dropout_and_not_out_of_range():
    t, raw = clean()
    raw[[10, 11, 300]] = 0.0
    flags, found = look(t, raw, dropout=0.0, low=-37e3, high=1.2e6)
    assert flagged(flags, Flag.DROPOUT) == [10, 11, 300]
    assert not flagged(flags, Flag.OVERRANGE)
    finding = found["dropout"]
    assert (finding.count, finding.index, finding.t) == (3, 10, pytest.approx(0.1))
    assert "0 mA" in finding.text


def test_codes_next_to_each_other_are_all_recognised():
    """The samples of one code are no neighbours for the next one: 0 lies between -999 and readings of 8 mA."""
    t, raw = clean()
    raw[100:102] = -999.0, 0.0
    flags, _ = look(t, raw)
    assert flagged(flags, Flag.DROPOUT) == [100, 101]


def test_gaps_are_not_closed():
    t, raw = clean()
    t[200:] += 8.0
    flags, found = look(t, raw)
    assert flagged(flags, Flag.GAP) == [200]
    assert "8.01 s" in found["gap"].text


def test_a_jump_back_makes_doubtful_what_has_its_time_twice():
    t, raw = clean(1000)
    t[500:] -= 2.0
    flags, found = look(t, raw)
    assert flagged(flags, Flag.TIME_JUMP) == list(range(500, 700))
    assert found["time-jump"].index == 500
    assert "back by 1.99 s" in found["time-jump"].text


def test_a_leap_ahead_is_an_error_of_the_clock():
    t, raw = clean()
    t[300:] += 3600.0
    flags, found = look(t, raw)
    assert flagged(flags, Flag.TIME_JUMP) == [300]
    assert "leap" in found


def test_time_that_does_not_move():
    flags, _ = look(np.zeros(20), np.ones(20))
    assert flagged(flags, Flag.TIME_JUMP) == list(range(20))


def test_a_wrong_unit_of_time_shows_as_the_rate():
    t, raw = clean()
    _, found = look(t * 1000, raw, gap=100.0)
    assert "is the unit of time right?" in found["rate"].text


def test_a_stuck_channel():
    t, raw = clean()
    raw[100:200] = raw[100]
    flags, _ = look(t, raw, stale_after=0.5)
    assert flagged(flags, Flag.STALE) == list(range(151, 200))


def test_values_out_of_range_and_counts_at_its_end():
    t, raw = clean()
    raw[7] = 30.0
    assert flagged(look(t, raw, low=0.0, high=1.2e6)[0], Flag.OVERRANGE) == [7]
    counts = np.round(raw * 10)
    counts[9] = 0.0
    flags, _ = look(t, counts, whole=True, low=-300e3, high=1e9)
    assert flagged(flags, Flag.OVERRANGE) == [9]


def test_repeated_rows():
    t, raw = clean()
    t[41], raw[41] = t[40], raw[40]
    t[61] = t[60]
    assert flagged(look(t, raw)[0], Flag.SUSPECT) == [41]


def test_missing_values_are_dropouts():
    t, raw = clean()
    raw[5] = np.nan
    assert flagged(look(t, raw, whole=False, low=0.0, high=1e9)[0], Flag.DROPOUT) == [5]


def test_readings_that_cannot_be_counts_condemn_the_file():
    t, raw = clean()
    flags, found = look(t, raw, whole=True)
    assert found["not-whole"].level == "fault"
    assert len(flagged(flags, Flag.SUSPECT)) == len(t)
    counts = np.round(raw * 10)
    counts[3] += 0.4
    flags, found = look(t, counts, whole=True)
    assert flagged(flags, Flag.SUSPECT) == [3]
    assert found["not-whole"].level == "doubt"


def test_a_wrong_sign_is_doubted():
    t = np.linspace(0, 1, 100)
    flags = np.zeros(100, np.uint16)
    assert against_sign(flags, {"pressure": t, "force": t + 1}, "force") is None
    assert against_sign(flags, {"pressure": t, "force": 1 - t}, "force").kind == "sign"


def summary(force, pressure=640e3, point=0.012, trusted=True):
    return Summary(
        (("contraction", point),), {"force": force, "pressure": pressure}, trusted,
    )  # fmt: skip


def test_siblings_show_which_file_is_implausible():
    files = [summary(112), summary(101), summary(114), summary(14.7), summary(360, point=0.0)]
    found = compare(files, {"force": 0.3})
    assert [len(each) for each in found] == [0, 0, 0, 1, 0]
    (finding,) = found[3]
    assert finding.level == "fault"
    assert "peak 14.7 N" in finding.text
    assert "that of its siblings 106.5 N" in finding.text


def test_of_two_alone_either_may_be_wrong():
    found = compare([summary(112), summary(14.7)], {"force": 0.3})
    assert [each[0].level for each in found] == ["doubt", "doubt"]
    found = compare([summary(112), summary(14.7, trusted=False)], {"force": 0.3})
    assert [[f.level for f in each] for each in found] == [[], ["fault"]]


def test_exchanged_columns_and_wrong_units_are_implausible():
    good = [summary(100.0), summary(101.0), summary(99.0)]
    exchanged = Summary(good[0].point, {"force": 64.0, "pressure": 1e6}, True)
    found = compare([*good, exchanged], {"force": 0.3, "pressure": 0.1})
    assert {finding.kind for finding in found[3]} == {"sibling"}
    assert all(finding.level == "fault" for finding in found[3])
    assert compare([*good, exchanged], {}) == [[]] * 4, "without `siblings` in the map no peaks are compared"
    found = compare([*good, summary(100 / 9.80665)], {"force": 0.3})
    assert "kilograms for newtons" in found[3][0].text


def test_slopes_of_opposite_sign_are_no_repeats():
    """Of two that are exactly opposite the median is 0."""
    files = [replace(summary(100.0), slope=slope) for slope in (1e-3, -1e-3)]
    for (finding,) in compare(files, {}):
        assert finding.withholds
        assert "slopes over pressure of the files at its point are -1 N/kPa to 1 N/kPa" in finding.text


def test_a_lone_sample_far_from_its_neighbours_is_a_spike():
    t, raw = clean()
    raw[[60, 61, 62, 300]] += [1.9, 2.0, 1.9, -1.5]
    flags, found = look(t, raw)
    assert flagged(flags, Flag.SUSPECT) == [60, 61, 62, 300]
    finding = found["spike"]
    assert (finding.index, finding.count, finding.t) == (60, 4, pytest.approx(0.6))
    assert flagged(look(t, raw, spike=150e3)[0], Flag.SUSPECT) == []


def test_a_zero_in_a_command_that_rests_is_a_spike_and_its_steps_are_none():
    t = np.arange(500) * 0.01
    raw = np.where((t > 1.0) & (t < 3.0), 12.0, 8.0)
    assert not look(t, raw)[0].any()
    raw[[0, 250]] = 4.0
    assert flagged(look(t, raw)[0], Flag.SUSPECT) == [0, 250]


def test_what_a_muscle_really_does_is_no_spike():
    t = np.arange(1000) * 0.01
    rng = np.random.default_rng(3)
    ringing = np.where(t > 5, 1 - np.exp(-(t - 5) * 4) * np.cos((t - 5) * 50), 0.0)
    for raw in (
        8 + 4 * (t > 5) + rng.normal(0, 0.003, len(t)),
        8 + 4 * ringing + rng.normal(0, 0.003, len(t)),
        8 + 4 * np.sin(2 * np.pi * 5 * t) + rng.normal(0, 0.003, len(t)),
        8 + t + rng.normal(0, 0.05, len(t)),
        np.round(rng.normal(0, 0.4, len(t))) + 8,
        8 + np.floor(t / 0.09) * 0.01,
    ):
        assert not look(t, raw)[0].any()


def test_numbers_that_no_device_gives_are_a_fault():
    t, raw = clean()
    raw[20:40] = 1.8e-307
    raw[60] = 1e200
    flags, found = look(t, raw)
    assert flagged(flags, Flag.SUSPECT) == [*range(20, 40), 60]
    assert found["absurd"].level == "fault"


def test_infinite_readings_are_no_readings():
    t, raw = clean()
    raw[[5, 9]] = [np.inf, -np.inf]
    assert flagged(look(t, raw)[0], Flag.DROPOUT) == [5, 9]
