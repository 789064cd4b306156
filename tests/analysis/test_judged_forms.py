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
SEEDS = {"free-contraction": 24, "isometric-pressurisation": 20, "step-displacement": 12, "gain-steps": 4, "relay": 4}
"""Sound campaigns in CI; open-loop steps take longer and are a study, and `test_open_loop` has some."""
STUDIED = 34
"""Campaigns of each cause and size."""
SMALL_SAMPLE = {"F_b", "m", "c", "F_ce", "K", "H", "p_0"}
"""Values of few repeats: Student's t of two degrees of freedom lets 1.3 % of them be two half widths off."""
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
        ("step-displacement", "creep", 1.0, "the force is not at rest"),
        ("step-displacement", "two-times", 1.0, "it is not one exponential"),
        ("step-displacement", "cell-drift", 1.0, "the force is not at rest"),
    ],
)
def test_a_departure_is_seen_with_its_reason_and_no_other_value_is_wrong(kind: str, cause: str, size: float, says: str):
    values, withheld = judged(kind, cause, size, 100)
    assert any(says in reason for reason in withheld)
    assert far(values) == []


@pytest.mark.parametrize(("cause", "size"), [("creep", 1.0), ("zero-drift", 0.5), ("slip", 0.25)])
def test_lengths_hold_what_still_moves_and_what_was_left(cause: str, size: float):
    values, _ = judged("free-contraction", cause, size, 100)
    assert far(values) == []
    assert covered(values) >= COVERED


@pytest.mark.study
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
