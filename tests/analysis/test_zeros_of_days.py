"""A load a day, each day with zeros of its own within what the calibration leaves open: no day's zero is a slip."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.contraction_relaxation.reduction import reduce
from tests.analysis.test_contraction_sensors import TRUE
from tests.analysis.test_joined_days import CELLS, day, values

KNOWN = {"pressure": 1.5e3, "displacement": 20e-6, "force": 1.0}


@pytest.mark.parametrize("seed", range(3))
def test_zeros_of_each_day_are_in_the_intervals_and_are_no_slip(seed):
    chance, runs = np.random.default_rng(seed), []
    for number, weight in enumerate((60.0, 130.0, 200.0)):
        run = day(number)
        off = {name: 0.5 * by * chance.standard_normal() for name, by in KNOWN.items() if name != "displacement"}
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
    analysis = reduce(runs, {"replays": 2})
    assert "slipped" not in " ".join(f.text for f in analysis.findings)
    given = [e for e in values(analysis) if e.value is not None and e.symbol in ("F_ce", "K", "B_c")]
    assert all(abs(e.value - TRUE[e.symbol](e.at["pressure"])) < e.parts.combined for e in given), given
