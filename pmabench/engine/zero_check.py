"""The session's zeros looked at again when the run is over and vented; knows no session."""

from __future__ import annotations

from typing import Any

import numpy as np

from pmabench.engine.acquire import Acquisition, Samples

SPAN = 0.3
"""How long the zeros are looked at [s]."""
LONGEST = 5.0
"""How long they are waited for to come to rest [s]."""


def zero_check(acquisition: Acquisition, zeroed: tuple[str, ...], *, unloaded: bool) -> dict[str, dict[str, Any]]:
    """Mean of each zeroed channel now [SI]; it is a `drift` where the channel is at its zero again.

    The pressure does, vented. The force does where hands took every load off. Nobody knows of the displacement.
    """
    deadline = acquisition.clock.now() + LONGEST
    means, noise = _means(acquisition, zeroed)
    while acquisition.clock.now() < deadline:
        before, (means, noise) = means, _means(acquisition, zeroed)
        if all(abs(mean - before[name]) <= noise[name] for name, mean in means.items() if name in before):
            break
    found: dict[str, dict[str, Any]] = {}
    for name, mean in means.items():
        at_zero = name == "pressure" or (name == "force" and unloaded)
        found[name] = {"reading": mean, "drift": mean if at_zero else None}
    return found


def _means(acquisition: Acquisition, names: tuple[str, ...]) -> tuple[dict[str, float], dict[str, float]]:
    """Mean and rms noise over the next `SPAN`."""
    kept: dict[str, list[float]] = {name: [] for name in names}

    def keep(block: Samples) -> None:
        for name in names:
            if name in block.values:
                kept[name].extend(float(value) for value in block.values[name])

    acquisition.pass_time(SPAN, keep)
    values = {name: column for name, column in kept.items() if column}
    means = {name: float(np.mean(column)) for name, column in values.items()}
    return means, {name: float(np.std(column)) + 1e-12 for name, column in values.items()}
