"""A load a day, each day with zeros of its own within what the calibration leaves open: no day's zero is a slip."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.contraction_relaxation.reduction import reduce
from tests.analysis.test_contraction_sensors import TRUE
from tests.analysis.test_joined_days import CELLS, day, values

KNOWN = {"pressure": 1.5e3, "displacement": 20e-6, "force": 1.0}


LINE = "zero of force from session to session"


def test_zeros_of_each_day_are_in_the_intervals():
    """Small ones: of a tenth of what the calibration leaves open, two campaigns of three are already withheld."""
    given = [e for e in values(campaign(0, 0.05)) if e.value is not None and e.symbol in ("F_ce", "K", "B_c")]
    assert len(given) == 9
    assert all(abs(e.value - TRUE[e.symbol](e.at["pressure"])) < e.parts.combined for e in given), given
    assert all(any(line.name == LINE and line.half > 0 for line in e.budget) for e in given)


@pytest.mark.parametrize("seed", range(2))
def test_zeros_as_large_as_their_calibration_allows_are_no_slip_and_are_withheld_without_naming_a_cause(seed):
    """Zeros of loads and a bend look alike with one load a day, and nothing of it is a value."""
    analysis = campaign(seed, 0.5)
    said = " ".join(f.text for f in analysis.findings)
    assert "slipped" not in said
    assert all(e.value is None for e in values(analysis))
    assert ("of which these data do not make sure" in said) == (analysis.facts["form"]["ratio"] < 1.2)
    assert ("the cause is unknown" in said) == (analysis.facts["form"]["ratio"] >= 1.2)


def campaign(seed, share):
    """The analysis of a load a day; zeros of each day by chance, `share` of `KNOWN` is their standard deviation."""
    chance, runs = np.random.default_rng(seed), []
    for number, weight in enumerate((60.0, 130.0, 200.0)):
        run = day(number)
        off = {name: share * by * chance.standard_normal() for name, by in KNOWN.items() if name != "displacement"}
        trials = [
            replace(trial, channels={name: y + off.get(name, 0.0) for name, y in trial.channels.items()})
            for trial, (load, _) in zip(run.trials, CELLS, strict=True)
            if load == weight
        ]
        channels = {
            name: replace(one, offset_uncertainty=KNOWN[name], gain_uncertainty=1e-3)
            for name, one in run.channels.items()
        }
        runs.append(replace(run, trials=tuple(trials), channels=channels))
    return reduce(runs, {"replays": 2})
