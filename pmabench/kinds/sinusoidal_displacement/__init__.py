"""Sinusoidal motion of the driven end at constant pressure: K, B, F_c, loops.

- `reduction`, with effects of filters, steps and a varying pressure; made of `fit`, `form` (corrections
  and contradictions by harmonics and creep), `pressure`
- protocol files: `protocol`; one trial on the display: `reduction`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("F_ce", "contractile force", "force", headline=True),
    Result("K", "stiffness", "stiffness", headline=True, positive=True),
    Result("K_A", "stiffness over the stroke", "stiffness", headline=True, positive=True),
    Result("B", "damping, mean of both directions", "damping", headline=True, plot="Damping", positive=True),
    Result("F_c", "Coulomb friction", "force", headline=True, positive=True),
    Result("F", "force", "force"),
    Result("H", "loop width", "force"),
    Result("W", "loop area, energy lost per cycle", "work", positive=True),
    Result("P_err", "largest error of the pressure", "pressure"),
    Result("F_rms", "rms error of the modelled force", "force"),
    Result("phi", "phase of force before displacement", "angle"),
)
METHODS = {
    "sine-harmonic": (
        "Three-parameter sine fits (IEEE 1057) of measured displacement and force at the known frequency: K_A is −Re(F/"
        "x), K that at the mean, corrected by the third harmonic; −Im(F/x) A = B ω A + 4 F_c/π, a straight line over "
        "the speed ω A: B and F_c are means of both directions."
    ),
    "loop-width": (
        "Width of the force–displacement loop at mid stroke, 2 B ω A + 2 F_c, a straight line over the speed ω A. What "
        "is left at 0 Hz is true hysteresis; the rest is phase lag."
    ),
    "sine-mean": (
        "Mean force over whole cycles less its second harmonic, a straight line over the speed ω A, at 0 Hz: halfway "
        "between both branches, so that half of what friction differs by direction is in it. Where B_c and B_r differ "
        "the line rises by (B_r − B_c)/π. How far it is from the middle of the branches at mid stroke is in the method "
        "part. F_ce only where the stroke holds x = 0."
    ),
    "pressure error": (
        "Largest difference of measured and set pressure while moving in a direction, the mean over cycles."
    ),
    "modelled with set pressure": (
        "The force that a static model gives, F = f(x) + s(x) P through the branches of the slowest sines at all "
        "pressures, with damping and friction of the harmonics and the set pressure as input: what an ideal source of "
        "pressure would make of it (paper 3)."
    ),
    "modelled with measured pressure": "As modelled with set pressure, with the pressure that was measured.",
}
KIND = Kind(
    name="sinusoidal-displacement",
    title="Sinusoidal displacement",
    order=30,
    results=RESULTS,
    reduction="pmabench.kinds.sinusoidal_displacement.reduction:reduce",
    papers=("paper 3, sinusoidal tests",),
    protocol="pmabench.kinds.sinusoidal_displacement.protocol:SinusoidalDisplacement",
    live="pmabench.kinds.sinusoidal_displacement.reduction:one_trial",
    moves="displacement",
    regulated=False,
    repeated="pmabench.analysis.shared.sine_loop:stiffness_of",
    repeated_is="stiffness",
    drifts="force",
    word="sine",
    offers="pmabench.kinds.sinusoidal_displacement.reduction:offers",
    methods=METHODS,
    figures={
        "loop": "pmabench.plotting.motion:loops",
        "bode": "pmabench.plotting.motion:bode",
        "sine-pressure": "pmabench.kinds.sinusoidal_displacement.pressure:sine_pressure",
    },
    front={"loop": "pmabench.plotting.motion:loops"},
    published={"loop": ("displacement", "force", "pressure")},
    parts={"slow rows": "pmabench.analysis.surface.trials:driven"},
    imported=Imported(
        Commanded(
            "displacement",
            point=(("frequency", "frequency"), ("mean", "mean"), ("amplitude", "amplitude"), ("pressure", "held")),
            sine=True,
        ),
        follows="force",
        shown="length sine",
    ),
)
