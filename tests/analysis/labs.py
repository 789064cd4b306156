"""Isometric tests of simulated labs: a straight line of force over pressure whose slope differs by session and test.

Nothing of pmabench makes the numbers; its records only carry them.
"""

from __future__ import annotations

import numpy as np

from pmabench.store.records import ChannelInfo, RunData, TrialData

SLOPE, BEGINS = 0.6e-3, 80e3
"""[N/Pa] and the pressure at which the force begins [Pa]: the truth of all labs."""
SAMPLES = 400


def lab(
    seed: int, sessions: int = 5, tests: int = 3, between: float = 0.005, within: float = 0.002, noise: float = 0.3
) -> list[RunData]:
    """The runs of a lab, one per session: fill and exhaust to 600 kPa at no contraction.

    `between`, `within`: standard deviation of the slope between sessions and between tests of one, as a share.
    """
    chance = np.random.default_rng(seed)
    runs = []
    half = np.linspace(0.0, 600e3, SAMPLES // 2)
    P = np.concatenate([half, half[::-1]])
    for number in range(sessions):
        slope = SLOPE * (1 + between * chance.standard_normal())
        trials = []
        for index in range(tests):
            of_test = slope * (1 + within * chance.standard_normal())
            F = np.maximum(0.0, of_test * (P - BEGINS)) + noise * chance.standard_normal(len(P))
            read = P + 500.0 * chance.standard_normal(len(P))
            trials.append(
                TrialData(
                    f"s{number}", index, {"contraction": 0.0}, index, False, "finished", np.arange(len(P)) / 100.0,
                    {"pressure": read, "force": F}, np.zeros(len(P), dtype=np.uint16), (), {},
                )
            )  # fmt: skip
        channels = {
            name: ChannelInfo(name, name, unit, 1.0, 0.0, -1e9, 1e9)
            for name, unit in (("pressure", "Pa"), ("force", "N"))
        }
        runs.append(
            RunData(
                id=f"s{number}", path="", kind="isometric", status="finished", simulated=True, manifest={}, plan={},
                events=(), channels=channels, rate=100.0, trials=tuple(trials),
            )
        )  # fmt: skip
    return runs
