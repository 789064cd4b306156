"""Ready-made plants with their sources, and plants as plain numbers for plans and plant files.

Presets are `ideal` or `bench`. `ideal`: no friction, no noise, an exact regulator after its dead time (usually 40 ms).
`bench`: lag, dead time, stiction and noise. Both have the hysteresis of the muscle.

The arm of paper 2 has four contractors, one of which bends it against a load at its end. Its state is the contraction
of the bending muscle relative to the arm's middle, x = r alpha: an arc of constant curvature whose middle line keeps
its length. The angle is that of `arm-angle` of the library; below 0.45 bar, where the paper has no data, it falls
linearly to 0 at zero pressure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from pmabench.model.air import Air
from pmabench.model.curve import Array, Curve
from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.free_air import AirPlant
from pmabench.model.hysteresis import Hysteresis, rubber
from pmabench.model.identified.muscle import IdentifiedMuscle
from pmabench.model.identified.plant import IdentifiedPlant
from pmabench.model.motion import Noise
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.overrides import Overrides
from pmabench.model.plant import Plant
from pmabench.model.real.muscle import Creep, RealMuscle, Stops, Surface, reference
from pmabench.model.real.plants import RealDrivenPlant, RealPlant
from pmabench.model.regulator import Regulator

ARM_STIFFNESS, ARM_DAMPING = 5e3, 1e3
"""Assumed stiffness [N/m] and damping [N.s/m], which determine the transient; paper 2 gives none."""
ARM_STEP = 1e3
"""Spacing of the points of angle over pressure [Pa]; linear interpolation is within 0.02 deg."""
ARM_STOP = 0.20
"""End stop of the bending muscle as contraction [1]: 115 deg, beyond all data of paper 2."""
GRAVITY = 9.81
"""Gravity, to convert the load at the arm's end to a mass [m/s2]."""


@dataclass(frozen=True)
class Arm:
    """The arm of paper 2: `length` of its muscles, `radius` of the circle of the outer ones [m]."""

    name: str = "arm of four contractors of 30 cm"
    length: float = 0.30
    radius: float = 0.03
    friction: Friction = field(default_factory=Friction)

    def under(self, force: float) -> Muscle:
        """The arm as an unloaded muscle that reaches x = r alpha, for the load `force` [N] at its end.

        Raises
        ------
        ValueError
            For loads beyond those of paper 2.
        """
        from pmabench.model.library import MODELS  # needs the presets, which need this module

        model = MODELS["arm-angle"]
        pressure, known = model.parameters
        load = force / GRAVITY
        if not known.low <= load <= known.high * (1 + 1e-9):
            most = f"{known.low:g} to {known.high:g} kg"
            raise ValueError(f"the arm of paper 2 is known for {most} at its end, not for {load:.4g} kg")
        P = np.linspace(pressure.low, pressure.high, round((pressure.high - pressure.low) / ARM_STEP) + 1)
        angle = model.evaluate({"pressure": P, "load": min(load, known.high)})["angle"]
        pull = ARM_STIFFNESS * self.radius * np.maximum(angle, 0.0)
        return Muscle(
            name=self.name,
            F_ce=Curve.through([0.0, *P.tolist()], [0.0, *pull.tolist()]),
            K=Curve(((ARM_STIFFNESS,),)),
            B_c=Curve(((ARM_DAMPING,),)),
            B_r=Curve(((ARM_DAMPING,),)),
            friction=self.friction,
            length=self.length,
            stop=ARM_STOP * self.length,
        )


class ArmPlant(Plant):
    """The arm with the regulator of its bending muscle; a load changes the final angle and the moving mass."""

    def __init__(
        self, arm: Arm, regulator: Regulator, *, force: float = 0.0, mass: float = 0.5, start: float = 0.0
    ) -> None:
        self.arm = arm
        super().__init__(arm.under(force), regulator, force=force, mass=mass, start=start)

    def load(self, force: float, mass: float) -> None:
        """Change the load at the arm's end: `force` [N] and moving `mass` [kg > 0]; ValueError as in `Arm.under`."""
        super().load(0.0, mass)
        self.muscle = self.arm.under(force)
        self._f_ce, self._stiffness = self.muscle.F_ce.function(), self.muscle.K.function()
        self._damping = {1: self.muscle.B_c.function(), -1: self.muscle.B_r.function()}


if TYPE_CHECKING:
    from pmabench.model.published_muscles import ContractorMuscle, DaerdenMuscle

    AnyMuscle: TypeAlias = Muscle | DaerdenMuscle | ContractorMuscle | Arm | RealMuscle

N_PER_MM = 1e3


def paper0() -> Muscle:
    """Festo MAS-20-250 with coefficients assumed to reproduce the ranges of paper 0, without friction.

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
    """Festo MAS-20-250 of Serres and others 2009, without friction.

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


def paper0_air() -> Muscle:
    """The muscle of `paper0` with an assumed braid of 20 mm and 25 deg, whose volume the regulator has to fill."""
    return replace(paper0(), name="MAS-20-250 paper0 with air", diameter=20e-3, braid_angle=math.radians(25))


def dmsp_40_305(fce_eval: str = "x0") -> Muscle:
    """Festo DMSP-40-305 of paper 1: S and D as printed, the rest assumed (`pmabench.model.published_muscles`)."""
    from pmabench.model.published_muscles import dmsp_40_305  # needs the library of models, which needs this module

    return dmsp_40_305(fce_eval)


MUSCLES: dict[str, Callable[[], Muscle]] = {
    "paper0": paper0,
    "paper0-air": paper0_air,
    "serres2009": serres2009,
    "dmsp-40-305": dmsp_40_305,
}
"""Plants with a three-element muscle, by name."""
CONTRACTORS = {f"contractor-{cm}": cm / 100 for cm in (15, 20, 25, 30, 40)}
"""Contractors of paper 2 -> length [m] (`pmabench.model.published_muscles`)."""
ARM = "arm-30"
"""The arm of four contractors of paper 2 (`Arm`)."""
REAL = "real"
"""The muscle with nonlinear force, hysteresis and creep (`pmabench.model.real.muscle`)."""
PLANTS = (*MUSCLES, "daerden", *CONTRACTORS, ARM, REAL)
"""All plants; `daerden` is the muscle of paper 3, for a driven end only (`pmabench.model.published_muscles`)."""
DAERDEN_HEIGHT, DAERDEN_WIDTH = 30.0, 0.006
"""Its hysteresis: half width of the loop [N], contraction over which a reversal fades to 1/e [1]; paper 3 shows 60 N
between the branches."""

BENCH_FRICTION = Friction(F_s=10.0, F_c=6.0, speed=1e-3)
COULOMB = Friction(F_s=10.0, F_c=10.0)
"""For a muscle whose damping prevents stick-slip."""
BENCH_NOISE = Noise(pressure=500.0, displacement=2e-6, force=0.3)
ARM_FRICTION, ARM_NOISE = Friction(F_s=0.5, F_c=0.5), Noise(pressure=500.0, displacement=30e-6)
"""Assumed: a dead zone of 0.38 deg between both directions, and noise of the angle of 0.06 deg."""
BENCH_LAG = 0.0955
BENCH_SECOND = {"natural_frequency": 2.5, "damping_ratio": 0.9}
"""A second-order regulator with a 90 % rise time of 0.22 s [Hz, 1]."""
BENCH_FOLLOW_LAG = 0.005
DEAD_TIME = 0.04
REAL_REGULATOR = Regulator(dead_time=0.02, lag=BENCH_LAG, vent_ratio=1.5)
KINDS = ("ideal", "bench")


@dataclass(frozen=True)
class Setup:
    """All parameters of a simulated bench."""

    muscle: AnyMuscle
    regulator: Regulator
    noise: Noise
    follow_lag: float
    """First-order lag of a displacement actuator behind its command [s]."""
    hysteresis: Hysteresis | None = None
    """Hysteresis of a driven end; None for none."""
    air: Air | None = None
    """Air flow of the regulator; None where the pressure does not depend on the motion."""
    relaxes: Creep | None = None
    """Relaxation of the rubber, at a driven end; None for none."""
    hose: float = 0.0
    """Volume of the hose, filled together with the muscle [m3]."""
    parallel: int = 1
    """Number of equal muscles in parallel at a driven end."""

    def free(self, force: float = 0.0, mass: float = 0.5, start: float = 0.0) -> Plant | RealPlant:
        """The plant with a load F_L = `force` [N] and moving mass `mass` [kg] on its free end, from `start` [s] on.

        Raises
        ------
        ValueError
            For a muscle without a free-end model, a load outside the model's range, or rubber that relaxes.
        """
        if self.relaxes is not None:
            raise ValueError("relaxes is for a driven end")
        if isinstance(self.muscle, Arm):
            return ArmPlant(self.muscle, self.regulator, force=force, mass=mass, start=start)
        if isinstance(self.muscle, RealMuscle):
            return RealPlant(self.muscle, self.regulator, force=force, mass=mass, start=start)
        muscle = self.muscle if isinstance(self.muscle, Muscle) else self.muscle.free()
        if self.air is not None:
            return AirPlant(muscle, self.regulator, self.air, force=force, mass=mass, start=start)
        return Plant(muscle, self.regulator, force=force, mass=mass, start=start)

    def driven(self, actuator: Actuator, position: float = 0.0, start: float = 0.0) -> DrivenPlant:
        """The plant with its end at `position` [m], driven by `actuator`, from `start` [s] on.

        The actuator is limited to the valid range of the muscle's formulas, and has the lag `follow_lag`.

        Raises
        ------
        ValueError
            For an arm, which has no driven end.
        """
        if isinstance(self.muscle, Arm):
            raise ValueError("the end of an arm carries loads; nothing drives it")
        actuator = replace(actuator, lag=self.follow_lag)
        if not isinstance(self.muscle, Muscle):
            low, high = (share * self.muscle.length for share in self.muscle.reach)
            actuator = replace(actuator, low=max(actuator.low, low), high=min(actuator.high, high))
        if isinstance(self.muscle, RealMuscle):
            return RealDrivenPlant(self.muscle, self.regulator, actuator, position=position, start=start)
        air = (self.air, self._volume) if self.air and hasattr(self.muscle, "volume") else None
        return DrivenPlant(
            self.muscle, self.regulator, actuator, hysteresis=self.hysteresis, air=air, relaxes=self.relaxes,
            parallel=self.parallel, position=position, start=start,
        )  # fmt: skip

    def _volume(self, x: Array) -> Array:
        """Volume of muscles and hose [m3] at contractions x [m]."""
        return np.asarray(self.parallel * self.muscle.volume(x) + self.hose)  # type: ignore[union-attr]


NOT_FOR: tuple[tuple[tuple[str, ...], Callable[[Setup], bool], str], ...] = (
    (("fce_eval",), lambda _: True, ": it is for the plant dmsp-40-305"),
    (("hysteresis",), lambda setup: setup.hysteresis is None, "; it is for the plant daerden"),
    (("relaxes",), lambda setup: isinstance(setup.muscle, Muscle | Arm | RealMuscle), "; it is for the plant daerden"),
    (("conductance_fill", "conductance_vent", "polytropic"), lambda setup: setup.air is None,
     ": its volume is not known"),
    (("hysteresis_x", "hysteresis_p", "creep", "bend", "first_cycle"),
     lambda setup: not isinstance(setup.muscle, RealMuscle), "; it is for the plant real"),
    (("F_s", "F_c"), lambda setup: isinstance(setup.muscle, RealMuscle), ": its friction is its hysteresis"),
    (("parallel", "hose"), lambda setup: isinstance(setup.muscle, RealMuscle), ": it is one muscle without air"),
    (("b_relax",), lambda setup: isinstance(setup.muscle, Arm), ": it has one damping"),
    (("F_s", "F_c", "b_relax"), lambda setup: not isinstance(setup.muscle, Muscle | Arm | RealMuscle),
     ": it has no friction and no damping by speed"),
)  # fmt: skip
"""Overrides, the setups to which they do not apply, and the reason for the message."""


def preset(plant: str, kind: str = "bench", overrides: Overrides | None = None) -> Setup:
    """The parameters of `plant` (one of `PLANTS`) as `ideal` or `bench`, with overrides.

    Raises
    ------
    ValueError
        For an unknown name or an invalid value.
    """
    if plant not in PLANTS:
        raise ValueError(f'no plant "{plant}"; known: {", ".join(PLANTS)}')
    setup = Setup(reference(), Regulator(dead_time=DEAD_TIME, lag=BENCH_LAG), BENCH_NOISE, BENCH_FOLLOW_LAG)
    if plant == REAL:
        return changed(replace(setup, regulator=REAL_REGULATOR), kind, overrides)
    if plant == ARM:
        return changed(replace(setup, muscle=Arm(friction=ARM_FRICTION), noise=ARM_NOISE), kind, overrides)
    if plant in MUSCLES:
        muscle = replace(MUSCLES[plant](), friction=COULOMB if plant == "dmsp-40-305" else BENCH_FRICTION)
        if plant == "dmsp-40-305" and overrides and overrides.fce_eval is not None:
            muscle = replace(muscle, F_ce=dmsp_40_305(overrides.fce_eval).F_ce)
            overrides = replace(overrides, fce_eval=None)
        setup = replace(setup, muscle=muscle)
        if plant != "paper0-air":
            return changed(setup, kind, overrides)
    from pmabench.model import published_muscles as published  # needs the library of models, which needs this module

    if plant == "paper0-air":
        setup = replace(setup, regulator=Regulator(DEAD_TIME, **BENCH_SECOND), air=published.assumed_air())
    elif plant in CONTRACTORS:
        setup = replace(setup, muscle=published.ContractorMuscle(name=plant, length=CONTRACTORS[plant]))
    else:
        stretchy = published.DaerdenMuscle()
        hysteresis = Hysteresis(DAERDEN_HEIGHT, DAERDEN_WIDTH * stretchy.length)
        setup = replace(setup, muscle=stretchy, hysteresis=hysteresis, air=published.assumed_air())
    return changed(setup, kind, overrides)


def changed(setup: Setup, kind: str = "bench", overrides: Overrides | None = None) -> Setup:
    """`setup` unchanged (`bench`) or without friction, noise and lags (`ideal`), with overrides.

    Raises ValueError for an unknown kind or an invalid override.
    """
    if kind not in KINDS:
        raise ValueError(f'no preset "{kind}"; known: {", ".join(KINDS)}')
    real = kind == "bench"
    change = overrides or Overrides()

    def chosen(name: str, bench: float, ideal: float = 0.0) -> float:
        """The user's value of a parameter [SI], else the bench's or the ideal one."""
        value = getattr(change, name)
        return float(value) if value is not None else bench if real else ideal

    if change.friction is not None and change.friction < 0:
        raise ValueError("the factor on friction cannot be negative")
    if change.b_relax not in {None, "b_contract"}:
        raise ValueError(f'b_relax can only be "b_contract", not "{change.b_relax}"')
    for names, lacks, why in NOT_FOR:
        given = [name for name in names if getattr(change, name) is not None]
        if given and lacks(setup):
            raise ValueError(f"{given[0]} is not for the muscle {setup.muscle.name}{why}")
    hysteresis = setup.hysteresis
    if hysteresis is not None:
        height = hysteresis.height if change.hysteresis is None else change.hysteresis
        hysteresis = replace(hysteresis, height=height * (1.0 if change.friction is None else change.friction))
    muscle, regulator = _muscle(setup.muscle, change, real=real), _regulator(setup.regulator, change, chosen)
    air = None if setup.air is None else _air(setup.air, chosen)
    regulator = regulator if air is None else replace(regulator, leak=0.0)
    noise = setup.noise.scaled(chosen("noise", 1.0))
    lag = chosen("follow_lag", setup.follow_lag)
    return Setup(muscle, regulator, noise, lag, hysteresis, air, **_mounted(change))


def _mounted(change: Overrides) -> dict[str, Any]:
    """Settings of a driven end: relaxation, hose, and number of muscles; ValueError for invalid ones."""
    parallel, hose = change.parallel or 1.0, change.hose or 0.0
    if change.parallel is not None and (parallel != change.parallel or parallel != int(parallel) or parallel < 1):
        raise ValueError(f"{change.parallel:g} muscles side by side: a whole number from 1 on is expected")
    if hose < 0:
        raise ValueError(f"a hose holds 0 m3 or more, not {hose:g}")
    return {"relaxes": rubber(change.relaxes) if change.relaxes else None, "hose": hose, "parallel": int(parallel)}


def _muscle(muscle: AnyMuscle, change: Overrides, *, real: bool) -> AnyMuscle:
    """The muscle with changed friction and damping."""
    if isinstance(muscle, RealMuscle):
        return muscle.changed(change)
    if not isinstance(muscle, Muscle | Arm):
        return muscle
    given, share = muscle.friction if real else Friction(), 1.0 if change.friction is None else change.friction
    friction = Friction(
        F_s=share * (given.F_s if change.F_s is None else change.F_s),
        F_c=share * (given.F_c if change.F_c is None else change.F_c),
        speed=muscle.friction.speed,
    )
    slower: dict[str, Any] = {"B_r": muscle.B_c, "tau_r": None} if change.b_relax and isinstance(muscle, Muscle) else {}
    return replace(muscle, friction=friction, **slower)


def _regulator(given: Regulator, change: Overrides, chosen: Callable[..., float]) -> Regulator:
    """The changed regulator; a given lag makes it first order, a natural frequency second order."""
    lag, natural_frequency = chosen("regulator_lag", given.lag), chosen("natural_frequency", given.natural_frequency)
    regulator = Regulator(
        dead_time=chosen("dead_time", given.dead_time, given.dead_time),
        lag=0.0 if change.natural_frequency and change.regulator_lag is None else lag,
        natural_frequency=0.0 if change.regulator_lag and change.natural_frequency is None else natural_frequency,
        damping_ratio=chosen("damping_ratio", given.damping_ratio, given.damping_ratio),
        vent_ratio=chosen("vent_ratio", given.vent_ratio, 1.0),
        dead_band=chosen("dead_band", given.dead_band),
        leak=chosen("leak", given.leak),
    )
    if change.damping_ratio is not None and not regulator.natural_frequency:
        raise ValueError("damping_ratio is for a regulator of second order; give natural_frequency too")
    return regulator


def _air(air: Air, chosen: Callable[..., float]) -> Air | None:
    """The changed air flow; None if both conductances are 0. ValueError for an exponent outside 1 to 1.4."""
    air = replace(
        air,
        fill=chosen("conductance_fill", air.fill),
        vent=chosen("conductance_vent", air.vent),
        leak=chosen("leak", air.leak),
        polytropic=chosen("polytropic", air.polytropic, air.polytropic),
    )
    if not 1.0 <= air.polytropic <= 1.4:
        raise ValueError(f"polytropic {air.polytropic:g} is no exponent of air: 1 to 1.4 are expected")
    return air if air.fill or air.vent else None


@dataclass(frozen=True)
class Described:
    """A muscle with its regulator, its air flow, and a description of their source."""

    muscle: Muscle
    regulator: Regulator
    source: str
    domain: tuple[float, float]
    """Range of pressures in which the coefficients are known [Pa]; they are extrapolated outside."""
    air: Air | None = None
    """Air flow of the regulator; None where the pressure does not depend on the motion."""
    surface: IdentifiedMuscle | None = None
    """An identified muscle that is simulated in place of `muscle`, its three-element form."""

    def plant(self, force: float, mass: float, pressure: float = 0.0, x: float = 0.0) -> Plant | IdentifiedPlant:
        """The plant at `pressure` [Pa], at rest at `x` [m], with a load F_L = `force` [N] and moving `mass` [kg]."""
        if self.surface is not None:
            return IdentifiedPlant(self.surface, self.regulator, force=force, mass=mass, pressure=pressure, x=x)
        if self.air is not None:
            plant: Plant = AirPlant(self.muscle, self.regulator, self.air, force=force, mass=mass, pressure=pressure)
        else:
            plant = Plant(self.muscle, self.regulator, force=force, mass=mass, pressure=pressure)
        plant.x = min(max(0.0, x), self.muscle.stop)
        return plant

    def to_dict(self) -> dict[str, Any]:
        """Plain data: coefficients as polynomials of P, highest power first, joined at breaks (SI)."""
        return {
            "source": self.source,
            "domain": list(self.domain),
            "regulator": asdict(self.regulator),
            **({} if self.air is None else {"air": asdict(self.air)}),
            **({} if self.surface is None else {"surface": self.surface.to_dict()}),
            **{name: value for name, value in asdict(self.muscle).items() if value is not None},
        }

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Described:
        """From data of `to_dict`; missing entries (plans of earlier versions) get the defaults of `Muscle`."""
        values = {field.name: _value(field.name, data[field.name]) for field in fields(Muscle) if field.name in data}
        muscle = Muscle(**{"name": str(data["source"]), **values})
        low, high = data["domain"]
        air = Air(**data["air"]) if "air" in data else None
        surface = IdentifiedMuscle.of(data["surface"]) if "surface" in data else None
        return cls(muscle, Regulator(**data["regulator"]), str(data["source"]), (float(low), float(high)), air, surface)


def _value(name: str, data: Any) -> Any:
    """The value of a field of a muscle from plain data."""
    if name == "friction":
        return Friction(**data)
    if isinstance(data, Mapping):
        pieces = tuple(tuple(float(c) for c in piece) for piece in data["pieces"])
        return Curve(pieces, tuple(float(edge) for edge in data["breaks"]))
    return data if isinstance(data, str) else float(data)


def tabulated_force(P: Sequence[float], F_ce: Sequence[float]) -> Curve:
    """F_ce [N] as straight lines between points at increasing pressures P [Pa], extrapolated at both ends.

    Below the first point it goes down to 0 N, or to 0 N at 0 Pa where the first line would not reach 0 N at a positive
    pressure.
    """
    lines = Curve.through(P, F_ce).pieces[1:-1] or ((F_ce[0] / P[0] if P[0] > 0 else 0.0, 0.0),)
    edges = list(P[1:-1])
    slope, intercept = lines[0]
    if slope > 0 and intercept < 0:
        return Curve(((0.0,), *lines), (-intercept / slope, *edges))
    if P[0] > 0 and len(P) > 1:
        return Curve(((F_ce[0] / P[0], 0.0), *lines), (P[0], *edges))
    return Curve(lines, tuple(edges))


T = TypeVar("T")
COEFFICIENTS = ("F_ce", "K", "B_c", "B_r", "tau_r")


def setup_of(numbers: Mapping[str, Any]) -> Setup:
    """The setup of a simulated bench from plain numbers (SI).

    Each coefficient is either `points`, pairs of pressure and value, or the arguments of `Curve.printed`.
    """
    regulator, noise, lag = Regulator(**numbers["regulator"]), Noise(**numbers["noise"]), float(numbers["follow_lag"])
    if numbers["law"] in ("daerden", "contractor"):
        return _published(numbers, regulator, noise, lag)
    if numbers["law"] == "real":
        return Setup(_real(numbers), regulator, noise, lag)
    given: dict[str, Any] = {symbol: _curve(numbers[symbol]) for symbol in COEFFICIENTS if symbol in numbers}
    given |= {size: float(numbers[size]) for size in ("length", "stop", "diameter", "braid_angle") if size in numbers}
    muscle = Muscle(str(numbers["name"]), friction=Friction(**numbers["friction"]), **given)
    return Setup(muscle, regulator, noise, lag, air=_air_of(numbers.get("flow"), regulator))


def _curve(given: Mapping[str, Any]) -> Curve:
    if "points" in given:
        pressures, values = zip(*given["points"], strict=True)
        return Curve.through(pressures, values)
    return Curve.printed(*given["pieces"], breaks=given["breaks"], unit=given["unit"], pressure=given["pressure"])


def _published(numbers: Mapping[str, Any], regulator: Regulator, noise: Noise, lag: float) -> Setup:
    """The setup of a muscle of paper 2 or 3; only the latter has hysteresis and volume."""
    from pmabench.model import published_muscles as published  # needs the library of models, which needs the presets

    if numbers["law"] == "contractor":
        return Setup(_record(published.ContractorMuscle, numbers), regulator, noise, lag)
    muscle = _record(published.DaerdenMuscle, numbers)
    loop = numbers["hysteresis"]
    hysteresis = loop and Hysteresis(float(loop["height"]), float(loop["width"]) * muscle.length)
    return Setup(muscle, regulator, noise, lag, hysteresis, _air_of(numbers["flow"], regulator))


def _real(numbers: Mapping[str, Any]) -> RealMuscle:
    kinds: dict[str, type] = {"surface": Surface, "over_x": Stops, "over_P": Stops, "creep": Creep}
    parts: dict[str, Any] = {name: _record(kind, numbers[name]) for name, kind in kinds.items()}
    curves = {name: _curve(numbers[name]) for name in ("B_c", "B_r")}
    return _record(RealMuscle, {**numbers, **parts, **curves})


def _record(kind: type[T], numbers: Mapping[str, Any]) -> T:
    """The record of a kind from plain data, which may hold more; without friction, which these muscles do not have."""
    given = {one.name: numbers[one.name] for one in fields(kind) if one.name in numbers and one.name != "friction"}  # type: ignore[arg-type]
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in given.items()})


def _air_of(flow: Mapping[str, Any] | None, regulator: Regulator) -> Air | None:
    if flow is None:
        return None
    from pmabench.model.library.chamber import R  # as above

    kept = {name: float(flow[name]) for name in ("fill", "vent", "polytropic", "atmosphere")}
    return Air(**kept, rT=R * float(flow["temperature"]), leak=regulator.leak)
