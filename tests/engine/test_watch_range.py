"""A measured value at its limit, beyond it, or that is no number is a crossing at its sample, block or single (S2)."""

import math

import numpy as np
import pytest

from pmabench.bench.interface import TripRecord
from pmabench.engine.watch import Watch

PERIOD = 0.002
HIGH = TripRecord("pressure", None, 600e3, 0.0, "vent", "rig.yaml:1:1")
LOW = TripRecord("force", -50.0, None, 0.0, "vent", "rig.yaml:2:1")


def crossed(limit, values, start=0.0, watch=None):
    """Indices of the crossings that a watch tells of in one block."""
    values = np.asarray(values, float)
    t = start + np.arange(len(values)) * PERIOD
    return [trip.index for trip in (watch or Watch([limit])).look(t, {limit.channel: values})]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("limit", [HIGH, LOW], ids=["high", "low"])
def test_what_is_no_number_trips_at_its_sample(limit, value):
    assert crossed(limit, [0.0, 0.0, value, 0.0]) == [2]
    (trip,) = Watch([limit]).look_once(1.0, {limit.channel: value})
    assert trip.t == 1.0
    assert str(trip).startswith(f"{limit.channel} has no valid value at 1.000 s (rig.yaml")


@pytest.mark.parametrize(("value", "trips"), [(599_999.0, False), (600e3, True), (600_001.0, True)])
def test_a_value_at_its_upper_limit_trips(value, trips):
    assert crossed(HIGH, [0.0, value, 0.0]) == ([1] if trips else [])
    assert bool(Watch([HIGH]).look_once(0.0, {"pressure": value})) == trips


@pytest.mark.parametrize(("value", "trips"), [(-49.9, False), (-50.0, True), (-50.1, True)])
def test_a_value_at_its_lower_limit_trips(value, trips):
    assert crossed(LOW, [0.0, value, 0.0]) == ([1] if trips else [])
    assert bool(Watch([LOW]).look_once(0.0, {"force": value})) == trips


@pytest.mark.parametrize("bad", [700e3, math.nan])
def test_a_delay_counts_over_blocks_and_begins_anew_inside(bad):
    limit = TripRecord("pressure", None, 600e3, 0.009, "vent", "rig.yaml:1:1")
    watch = Watch([limit])
    assert crossed(limit, [0.0, bad, bad, bad], 0.0, watch) == []
    assert crossed(limit, [bad, 0.0, bad, bad], 4 * PERIOD, watch) == []
    assert crossed(limit, [bad, bad, bad, bad], 8 * PERIOD, watch) == [3], "9 ms after the sample at 6 periods"
