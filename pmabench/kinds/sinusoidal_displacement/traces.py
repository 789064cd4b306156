"""The figures' columns of driven sines: loops beside the fitted muscle, and the Bode table; no estimate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pmabench.analysis.results import Trace
from pmabench.analysis.shared.sine_loop import Sine, along
from pmabench.base.quantities import show
from pmabench.kinds.sinusoidal_displacement.fit import Muscle
from pmabench.store.records import Array

LONGEST_TRACE = 1500


def traces_of(at: Mapping[str, float], sines: Mapping[float, Sequence[Sine]], muscle: Muscle | None) -> list[Trace]:
    """One loop per frequency (the last cycle of its first trial), and the Bode table.

    `sines` by frequency [Hz]; `muscle` is None where K, B and F_c are not all told: no model stands beside the loops.
    """
    where = ", ".join(
        show(at[name], quantity) for name, quantity in (("pressure", "pressure"), ("mean", "length")) if name in at
    )
    where += f" ± {show(at['amplitude'], 'length')}" if "amplitude" in at else ""
    name = "-".join(f"{at[key]:g}" for key in at)
    held = {key: at[key] for key in ("pressure",) if key in at}
    traces = []
    groups = sorted(sines.items())
    for frequency, members in groups:
        sine = members[0]
        last = sine.t >= sine.t[-1] - 1 / frequency
        stride = -(-int(last.sum()) // LONGEST_TRACE)
        columns = {"displacement": sine.x, "force": sine.F}
        if muscle is not None:
            columns["model"] = along(sine, muscle.K, muscle.B, muscle.F_c)[1]
        traces.append(
            Trace(
                f"loop-{name}-{frequency:g}",
                "loop",
                f"Loop at {frequency:g} Hz, {where}",
                {name: values[last][::stride] for name, values in columns.items()},
                {"displacement": "length", "force": "force", "model": "force"},
                {"frequency": frequency, "width": sine.width, "area": sine.area} | held,
            )
        )

    def means(of: Callable[[Sine], float]) -> Array:
        return np.array([float(np.mean([of(member) for member in members])) for _, members in groups])

    traces.append(
        Trace(
            f"bode-{name}",
            "bode",
            f"Force over displacement, {where}",
            {
                "frequency": np.array([frequency for frequency, _ in groups]),
                "gain": means(lambda s: abs(s.ratio)),
                "phase": means(lambda s: s.phase),
                "stiffness": means(lambda s: s.stiffness),
                "loss": means(lambda s: s.loss),
                "speed": means(lambda s: s.speed),
                "width": means(lambda s: s.width),
            },
            {
                "frequency": "frequency",
                "gain": "stiffness",
                "phase": "angle",
                "stiffness": "stiffness",
                "loss": "force",
                "speed": "speed",
                "width": "force",
            },
            {} if muscle is None else {"K": muscle.K, "B": muscle.B, "F_c": muscle.F_c},
        )
    )
    return traces
