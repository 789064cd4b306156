"""How often the 95 % intervals of contraction runs hold the truth: 88 trials a run, many seeds, both reference plants.

`pytest -s -m study tests/analysis/test_coverage.py` prints the table. The simulation draws noise and counts only, and so
the intervals are those without a calibration part.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from pmabench.kinds.contraction_relaxation.reduction import reduce
from pmabench.store.analyses.results import Analysis
from tests.analysis.simulate import PRESSURES, contraction_run, rig
from tests.analysis.test_contraction import PAPER0, SERRES, of

TRUTH = {"paper0": PAPER0, "serres2009": SERRES}
SEEDS = 20
LEAST = {"paper0": 0.94, "serres2009": 0.92}
"""Over all coefficients; with 20 seeds and 31 coefficients that hang together the share scatters by about 0.015."""
Row = tuple[float, float]


def covered(plant: str, analyses: Iterable[Analysis]) -> dict[tuple[str, float], list[Row]]:
    """Relative error and relative half width of each coefficient at each pressure, one row a run."""
    rows: dict[tuple[str, float], list[Row]] = {}
    for analysis in analyses:
        for symbol, law in TRUTH[plant].items():
            for P, e in of(analysis, symbol).items():
                rows.setdefault((symbol, P), []).append((e.value / law(P) - 1, e.parts.combined / law(P)))
    return rows


def share(rows: Iterable[Row]) -> float:
    return float(np.mean([abs(error) < half for error, half in rows]))


def table(plant: str, rows: dict[tuple[str, float], list[Row]]) -> str:
    """Per coefficient and pressure: runs, share covered, mean error and mean half width in per cent."""
    lines = [f"{plant:12s}{'P [kPa]':>8s}{'runs':>6s}{'covered':>9s}{'error [%]':>11s}{'half [%]':>10s}"]
    for (symbol, P), found in sorted(rows.items(), key=lambda one: (list(TRUTH[plant]).index(one[0][0]), one[0][1])):
        errors, halves = np.array(found).T
        lines.append(
            f"{symbol:12s}{P / 1e3:8.0f}{len(found):6d}{share(found):9.2f}"
            f"{100 * errors.mean():+11.3f}{100 * halves.mean():10.3f}"
        )
    for symbol in TRUTH[plant]:
        lines.append(
            f"{symbol:12s}{'all':>8s}{share(r for key, f in rows.items() if key[0] == symbol for r in f):15.3f}"
        )
    return "\n".join(lines)


@pytest.mark.study
@pytest.mark.parametrize("plant", list(TRUTH))
def test_88_trials_cover_the_truth_everywhere(plant: str):
    rows = covered(plant, (reduce([contraction_run(rig(plant), seed=seed)]) for seed in range(SEEDS)))
    print("\n" + table(plant, rows))
    assert {P for symbol, P in rows if symbol == "K"} == set(PRESSURES)
    assert share(row for found in rows.values() for row in found) >= LEAST[plant]
    # K of serres2009 has its kink at 314 kPa, between two knots: 300 kPa must not suffer from it
    worst = min(share(found) for found in rows.values())
    assert worst >= 0.75, "with a true 95 % fewer than 15 of 20 come up once in 3,000 times"
