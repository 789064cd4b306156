"""What a force that comes late makes of sines: a filter or a delay that nobody declared looks like less damping."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.ramp_loop import LATE
from pmabench.analysis.shared.samples import lag_open
from pmabench.kinds.sinusoidal_displacement.fit import Fitted
from pmabench.store.analyses.results import Estimate


def with_late_force(estimates: Sequence[Estimate], fitted: Fitted) -> list[Estimate]:
    """The estimates with what the undeclared part of the force cell's lag may do to them, as a line of the budget.

    K + j omega B becomes (K + j omega B)(1 - j omega tau): B falls by K tau, K rises by omega^2 B tau.
    """
    tau = max(lag_open(member.run, "force") for member in fitted.group)
    K, B = abs(fitted.replayed.K), abs(fitted.replayed.B)
    amplitudes = {round(sine.frequency, 9): sine.amplitude for sine in (member.sine for member in fitted.group)}
    given = {e.at.get("frequency"): e.value for e in estimates if e.symbol == "W_c"}

    def effect(e: Estimate) -> float:
        frequency = e.at.get("frequency", 0.0)
        omega, A = 2 * pi * frequency, amplitudes.get(round(frequency, 9), 0.0)
        lost = pi * A**2 * omega * K * tau
        taken = (given.get(frequency) or 0.0) / (e.value or 1.0)
        return {
            "B": K * tau, "K": omega**2 * B * tau, "phi": omega * tau, "H": 2 * A * omega * K * tau, "W": lost,
            "W_c": lost / 2, "eta": lost / taken if e.symbol == "eta" and taken else 0.0,
        }.get(e.symbol, 0.0)  # fmt: skip

    return [weighed(e, [Doubt(LATE, "method", effect(e), False)]) for e in estimates]
