"""What sensors leave open of driven sines: filters that nobody declared, steps of channels, a pressure that swings.

Each is put into the samples, and all values are evaluated again. Knows measured trials; not how they are evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.ramp_loop import LATE
from pmabench.analysis.shared.samples import PLACES, STEPS, lag_open, noise_of, rounded
from pmabench.analysis.shared.sine_loop import along, evaluate
from pmabench.kinds.sinusoidal_displacement.fit import Fitted, Member
from pmabench.store.analyses.results import Estimate
from pmabench.store.records import Array

FILTERED, SWINGS = "filter of the pressure sensor", "pressure that swings with the sine"
SEEN = 4.0
"""Standard errors from which on a pressure is seen to swing with the sine."""
AT_MOST = 2.0
"""Force per pressure where it is not known, over F_ce/P: a muscle pulls from some pressure on only."""
ROOM = 1.02
"""A filter of all that is open is in the interval, whatever noise adds."""
Named = Mapping[tuple[object, ...], Estimate]
"""Estimates with a value by `name_of`."""
Effects = Mapping[tuple[object, ...], float]


def name_of(e: Estimate) -> tuple[object, ...]:
    """What identifies an estimate of a cell."""
    return e.symbol, e.method, *e.at.items()


def with_sensors(
    estimates: Sequence[Estimate], fitted: Fitted, evaluated: Callable[[Fitted], Named], *, late: bool
) -> list[Estimate]:
    """The estimates with what their sensors leave open; `late` where nothing states how late the force is.

    `evaluated` gives those of any lines in place of `fitted`. A filter may be of first order, which takes off from the
    amplitude, too, or a sharper one, which up to there delays only.
    """
    group = list({member.sine.frequency: member for member in fitted.group}.values())
    given = evaluated(Fitted.of(group, 0.0))

    def changed(*groups: Sequence[Member]) -> Effects:
        """The largest change of each value."""
        others = [evaluated(Fitted.of(group, 0.0)) for group in groups]
        return {name: max((_apart(e, other[name]) for other in others if name in other), default=0.0)
                for name, e in given.items()}  # fmt: skip

    effects = list[tuple[str, bool, Effects]]()
    effects.append((STEPS, False, _by_steps(fitted, evaluated)))
    if late:
        force, way = (max(ROOM * lag_open(m.run, name) for m in fitted.group) for name in ("force", "displacement"))
        filters = ([m.again(later) for m in group] for later in ({"force": force}, {"displacement": way}))
        delays = ([m.again(delay=by) for m in group] for by in (force, -way))
        effects.append((LATE, False, changed(*filters, *delays)))
    if any(m.per_pressure for m in fitted.group):
        filtered = [m.again({"pressure": ROOM * lag_open(m.run, "pressure")}) for m in group]
        effects.append((FILTERED, False, changed(filtered)))
    if any(map(_swings, fitted.group)):
        taken = changed([m.again(per_pressure=m.guess) for m in group])
        effects.append((SWINGS, True, {name: AT_MOST * change for name, change in taken.items()}))
    return [
        weighed(e, [Doubt(of, "method", sizes.get(name_of(e), 0.0), seen) for of, seen, sizes in effects])
        for e in estimates
    ]


def _apart(e: Estimate, other: Estimate) -> float:
    """How far another value is from an estimate; of a line over frequency, less what its own interval holds more.

    A filter that would bend a line is none of a line that is straight: K of many frequencies is not open by all that a
    filter would do to K at the highest.
    """
    more = 0.0 if e.at.get("frequency") else (other.parts.repeats or 0.0) - (e.parts.repeats or 0.0)
    return max(0.0, abs((other.value or 0.0) - (e.value or 0.0)) - max(0.0, more))


def _swings(member: Member) -> bool:
    """Whether the pressure is seen to swing with the sine, and its force was not taken off."""
    if member.per_pressure or not member.sine.ripple:
        return False
    noise = noise_of(member.trial.channels["pressure"]) * np.sqrt(2 / len(member.sine.t))
    return bool(abs(member.sine.ripple) > SEEN * noise)


def _by_steps(fitted: Fitted, evaluated: Callable[[Fitted], Named]) -> Effects:
    """What the steps of the channels make: the fitted muscle, rounded, evaluated again."""
    muscle, rows = fitted.replayed, list[tuple[Member, Array, Array]]()
    for member in {member.sine.frequency: member for member in fitted.group}.values():
        x, F = along(member.sine, muscle.K, muscle.B, muscle.F_c)
        rows.append((member, rounded(x, member.sine.steps[0]), rounded(F, member.sine.steps[1], 1)))
    if not any(np.ptp(signals, axis=0).any() for _, *channels in rows for signals in channels):
        return {}
    values = []
    for i in range(1 + PLACES):
        group = [replace(m, sine=evaluate(m.sine.t, x[i], F[i], m.sine.frequency, m.sine.pressure)) for m, x, F in rows]
        values.append({name: e.value or 0.0 for name, e in evaluated(Fitted.of(group, 0.0)).items()})
    return {
        name: 2 * float(np.sqrt(np.mean([(one.get(name, plain) - plain) ** 2 for one in values[1:]])))
        for name, plain in values[0].items()
    }
