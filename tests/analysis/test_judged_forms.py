"""Lengths without load, held lengths, steps and loops held against the independent simulators: right, or withheld.

`pytest -s -m study tests/analysis/test_judged_forms.py` prints the tables of all departures at three sizes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from os import cpu_count

import numpy as np
import pytest

from tests.analysis.judged_forms import KINDS, Value, judged

SIZES = (1.0, 0.5, 0.25)
FAR = 2.0
"""Half widths from the truth at which a value is a confident wrong number."""
COVERED = 0.93
CLEAN_WITHHELD = 0.02
SEEDS = {
    "free-contraction": 2, "isometric-pressurisation": 2, "step-displacement": 2, "gain-steps": 2, "relay": 1,
    "relaxation": 1, "joint-sweep": 1, "isobaric-gap": 1, "isobaric-line": 1, "closed-volume": 1, "recorded-sine": 2, "recorded-step": 1, "arm-angle": 1, "positioning": 2,
    "joint-torque": 1, "joint-step": 1, "platform-step": 1, "mass-flow": 1,
}  # fmt: skip
"""Sound campaigns in CI, a sample: the study takes a hundred; open-loop steps take longer, and `test_open_loop` has some."""
STUDIED = 34
"""Campaigns of each cause and size."""
Found = tuple[list[Value], list[str]]


def _asked(asked: tuple[str, str, float, int]) -> Found:
    return judged(*asked)


def studied(kind: str, cause: str, size: float, seeds: range) -> list[Found]:
    with ProcessPoolExecutor(cpu_count()) as executor:
        return list(executor.map(_asked, [(kind, cause, size, seed) for seed in seeds]))


def all_of(found: Iterable[Found]) -> list[Value]:
    return [value for values, _ in found for value in values]


def covered(values: Sequence[Value]) -> float:
    """Share of values whose interval holds the truth; 1 where there is none, for nothing wrong was said."""
    return float(np.mean([value.score <= 1 for value in values])) if values else 1.0


def far(values: Iterable[Value]) -> list[str]:
    return [f"{value.name}: {value.value:g} +- {value.half:g}, {value.score:.1f} half widths off" for value in values
            if value.score > FAR]  # fmt: skip


@pytest.mark.parametrize(("kind", "seeds"), SEEDS.items())
def test_values_of_sound_tests_hold_the_truth_and_nothing_is_withheld(kind: str, seeds: int):
    found = [judged(kind, "clean", 1.0, seed) for seed in range(seeds)]
    assert [reason for _, reasons in found for reason in reasons] == []
    values = all_of(found)
    assert len(values) > 0
    assert len(far(values)) <= 0.01 * len(values)
    assert covered(values) >= COVERED


@pytest.mark.parametrize(
    ("kind", "cause", "size", "says"),
    [
        ("free-contraction", "other-curve", 0.25, "off the sigmoid"),
        ("isometric-pressurisation", "cell-drift", 1.0, "the force cell drifts: at rest it reads 15 N"),
        ("isometric-pressurisation", "slip", 1.0, "a mount that slips"),
        ("isometric-pressurisation", "bend-x", 1.0, "the force over contraction is bent"),
        ("isometric-pressurisation", "force-lag", 1.0, "the force comes"),
        ("closed-volume", "slow-heat", 1.0, "heat, a leak that changes"),
        ("closed-volume", "sensor-lag", 1.0, "a pressure that comes late"),
        ("closed-volume", "other-room", 1.0, "read a barometer"),
        ("recorded-sine", "clipped", 1.0, "displacement is cut off"),
        ("recorded-sine", "start-up", 1.0, "from the first cycle to the last"),
        ("recorded-sine", "friction", 1.0, "the loop is no ellipse"),
        ("recorded-step", "creep", 1.0, "the contraction is not at rest"),
        ("recorded-step", "friction", 0.5, "dry friction holds it"),
        ("arm-angle", "creep", 1.0, "the angle is not at rest"),
        ("arm-angle", "slip", 1.0, "a cable or a mount slips"),
        ("arm-angle", "other-curve", 1.0, "it is another curve"),
        ("positioning", "drift", 1.0, "it moves in the window"),
        ("positioning", "hunting", 1.0, "the window"),
        ("relaxation", "cell-drift", 1.0, "without pressure the cell reads"),
        ("relaxation", "two-times", 0.25, "this is no straight line over log t"),
        ("relaxation", "short-rest", 1.0, "rest longer"),
        ("isobaric-gap", "lag", 1.0, "the force comes through a filter"),
        ("isobaric-gap", "backlash", 0.25, "look at the displacement sensor"),
        ("isobaric-gap", "wrong-sign", 1.0, "no muscle gives work back like that"),
        ("joint-sweep", "backlash", 0.25, "look at the angle sensor"),
        ("joint-torque", "gives-way-unseen", 0.5, "the torque is not at rest"),
        ("joint-torque", "creep", 0.25, "the torque is not at rest"),
        ("joint-torque", "backlash", 0.5, "the encoder or a coupling is loose"),
        ("joint-torque", "angle-scale", 0.5, "one of them has a wrong scale"),
        ("joint-torque", "not-linear", 1.0, "off a plane over the pressures"),
        ("joint-step", "slip", 0.5, "the encoder or its coupling slips"),
        ("platform-step", "bias-x", 0.5, "an axis has an offset or another scale"),
        ("platform-step", "filter-x", 0.5, "one axis of the accelerometer is"),
        ("mass-flow", "warms-up", 1.0, "not alike in both directions"),
        ("mass-flow", "one-way", 0.25, "its zero is not seen"),
        ("mass-flow", "clips", 1.0, "cut off at the end of the meter's range"),
        ("step-displacement", "creep", 1.0, "the force is not at rest"),
        ("step-displacement", "two-times", 1.0, "it is not one exponential"),
        ("step-displacement", "cell-drift", 1.0, "the force is not at rest"),
    ],
)
def test_a_departure_is_seen_with_its_reason_and_no_other_value_is_wrong(kind: str, cause: str, size: float, says: str):
    values, withheld = judged(kind, cause, size, 100)
    assert any(says in reason for reason in withheld)
    assert far(values) == []


@pytest.mark.parametrize(
    ("kind", "cause", "size"),
    [
        ("relaxation", "early", 1.0),
        ("isobaric-gap", "cell-drift", 1.0),
        ("isobaric-gap", "lag", 0.25),
        ("isobaric-line", "slip", 0.5),
        ("joint-sweep", "cell-drift", 1.0),
        ("joint-sweep", "lag", 0.25),
        ("free-contraction", "creep", 1.0),
        ("free-contraction", "zero-drift", 0.5),
        ("free-contraction", "slip", 0.25),
        ("closed-volume", "leak-changes", 1.0),
        ("closed-volume", "cooling", 1.0),
        ("recorded-sine", "drift", 1.0),
        ("recorded-sine", "late", 1.0),
        ("recorded-step", "bend", 1.0),
        ("positioning", "tail", 1.0),
        ("step-displacement", "force-lag", 1.0),
        ("recorded-sine", "other-frequency", 1.0),
        ("joint-torque", "cell-jump", 1.0),
        ("joint-torque", "slip", 0.5),
        ("joint-torque", "eccentric", 0.5),
        ("joint-step", "angle-lag", 1.0),
        ("joint-step", "noisy", 1.0),
        ("platform-step", "gyroscope-bias", 0.5),
        ("mass-flow", "zero-drift", 1.0),
        ("mass-flow", "slip", 1.0),
    ],
)
def test_intervals_hold_what_a_small_departure_does(kind: str, cause: str, size: float):
    values, _ = judged(kind, cause, size, 100)
    assert len(values) > 0
    assert far(values) == []
    assert covered(values) >= COVERED


def test_a_sweep_next_to_one_of_another_form_tells_nothing():
    """One of two repeats shows a slip as another form; the loop area of the other was 2.8 half widths off."""
    values, withheld = judged("joint-sweep", "slip", 1.0, 1028)
    assert values == []
    assert any("half of the sweeps at this point, or more, have another form" in reason for reason in withheld)


@pytest.mark.study
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("kind", KINDS)
def test_accepted_values_hold_the_truth_whatever_is_wrong(kind: str):
    everything: list[Value] = []
    clean: list[Found] = []
    for cause in KINDS[kind].full:
        for size in SIZES if cause != "clean" else (1.0,):
            found = studied(kind, cause, size, range(1000, 1000 + (3 if cause == "clean" else 1) * STUDIED))
            clean = found if cause == "clean" else clean
            values = all_of(found)
            everything += values
            withheld = sum(bool(reasons) for _, reasons in found)
            worst = max((value.score for value in values), default=0.0)
            print(f"\n{kind:26s}{cause:14s}{size:5.2f}{len(found):5d} withheld in {withheld:3d}, {len(values):6d} values, "
                  f"covered {covered(values):.3f}, worst {worst:5.2f}", end="")  # fmt: skip
            assert covered(values) >= COVERED - 0.03, f"{cause} x {size:g}"
    assert covered(everything) >= COVERED
    assert len(far(everything)) <= 0.002 * len(everything), far(everything)[:10]
    assert sum(bool(reasons) for _, reasons in clean) <= CLEAN_WITHHELD * len(clean)
