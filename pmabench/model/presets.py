"""Ready-made plants with their sources, each `ideal` and `bench`; knows no driver.

`ideal`: no friction, no noise, regulator exact behind 40 ms of dead time. `bench`: lag, dead time, stiction and noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.overrides import Overrides
from pmabench.model.regulator import Regulator
from pmabench.model.sensors import Noise

N_PER_MM = 1e3


def paper0() -> Muscle:
    """Festo MAS-20-250 with coefficients assumed so that the ranges of paper 0 come out, no friction.

    P in kPa: F_ce = 1.08 P - 49.0 >= 0 N; K = 5.6 + 1.0e-3 P + 9.7e-6 P^2 N/mm; B_c = 1.2 + 1.6e-3 P and
    B_r = 1.1 + 3.4e-3 P N.s/mm.
    """
    return Muscle(
        name="MAS-20-250 paper0",
        F_ce=Curve.printed((0.0,), (-49.0, 1.08), breaks=(49.0 / 1.08,)),
        K=Curve.printed((5.6, 1.0e-3, 9.7e-6), unit=N_PER_MM),
        B_c=Curve.printed((1.2, 1.6e-3), unit=N_PER_MM),
        B_r=Curve.printed((1.1, 3.4e-3), unit=N_PER_MM),
    )


def serres2009() -> Muscle:
    """Festo MAS-20-250 of Serres and others 2009, no friction.

    P in kPa: F_ce = 2.91 P + 44.6 N, below 150 kPa 3.207 P (a straight line to the origin); K = 32.7 - 0.0321 P up to
    314, 17 + 0.0179 P above, N/mm; B_c = 2.90; B_r = 1.57 up to 372, 0.311 + 0.00338 P above, N.s/mm.
    """
    return Muscle(
        name="MAS-20-250 serres2009",
        F_ce=Curve.printed((0.0, (2.91 * 150 + 44.6) / 150), (44.6, 2.91), breaks=(150.0,)),
        K=Curve.printed((32.7, -0.0321), (17.0, 0.0179), breaks=(314.0,), unit=N_PER_MM),
        B_c=Curve.printed((2.90,), unit=N_PER_MM),
        B_r=Curve.printed((1.57,), (0.311, 0.00338), breaks=(372.0,), unit=N_PER_MM),
    )


MUSCLES: dict[str, Callable[[], Muscle]] = {"paper0": paper0, "serres2009": serres2009}

BENCH_FRICTION = Friction(F_s=10.0, F_c=6.0, speed=1e-3)
BENCH_NOISE = Noise(pressure=500.0, displacement=2e-6, force=0.3)
BENCH_LAG = 0.0955
BENCH_FOLLOW_LAG = 0.005
DEAD_TIME = 0.04
KINDS = ("ideal", "bench")


@dataclass(frozen=True)
class Setup:
    """All parameters of a simulated bench."""

    muscle: Muscle
    regulator: Regulator
    noise: Noise
    follow_lag: float
    """First-order lag of a displacement actuator behind its command [s]."""


def preset(plant: str, kind: str = "bench", overrides: Overrides | None = None) -> Setup:
    """The parameters of `plant` (a key of `MUSCLES`) as `ideal` or `bench`, with overrides.

    Raises
    ------
    ValueError
        For a name that is not known or a value that cannot be.
    """
    if plant not in MUSCLES:
        raise ValueError(f'no plant "{plant}"; known: {", ".join(MUSCLES)}')
    muscle = replace(MUSCLES[plant](), friction=BENCH_FRICTION)
    regulator = Regulator(dead_time=DEAD_TIME, lag=BENCH_LAG)
    return changed(Setup(muscle, regulator, BENCH_NOISE, BENCH_FOLLOW_LAG), kind, overrides)


def changed(setup: Setup, kind: str = "bench", overrides: Overrides | None = None) -> Setup:
    """`setup` as it is (`bench`) or without friction, noise and lags (`ideal`), with overrides; ValueError as above."""
    if kind not in KINDS:
        raise ValueError(f'no preset "{kind}"; known: {", ".join(KINDS)}')
    real = kind == "bench"
    change = overrides or Overrides()

    def chosen(name: str, bench: float, ideal: float = 0.0) -> float:
        value = getattr(change, name)
        return float(value) if value is not None else bench if real else ideal

    full = setup.muscle.friction
    base = full if real else Friction()
    share = 1.0 if change.friction is None else change.friction
    if share < 0:
        raise ValueError("the factor on friction cannot be negative")
    friction = Friction(
        F_s=share * (base.F_s if change.F_s is None else change.F_s),
        F_c=share * (base.F_c if change.F_c is None else change.F_c),
        speed=full.speed,
    )
    muscle = replace(setup.muscle, friction=friction)
    if change.b_relax == "b_contract":
        muscle = replace(muscle, B_r=muscle.B_c)
    elif change.b_relax is not None:
        raise ValueError(f'b_relax can only be "b_contract", not "{change.b_relax}"')
    given = setup.regulator
    regulator = Regulator(
        dead_time=chosen("dead_time", given.dead_time, given.dead_time),
        lag=chosen("regulator_lag", given.lag),
        vent_ratio=chosen("vent_ratio", given.vent_ratio, 1.0),
        dead_band=chosen("dead_band", given.dead_band),
        leak=chosen("leak", given.leak),
    )
    noise = setup.noise.scaled(chosen("noise", 1.0))
    return replace(
        setup, muscle=muscle, regulator=regulator, noise=noise, follow_lag=chosen("follow_lag", setup.follow_lag)
    )
