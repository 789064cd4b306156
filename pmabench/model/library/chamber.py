"""Pressure in a muscle's chamber: rate from flow and volume, closed chamber, a driven muscle behind a regulator."""

from __future__ import annotations

import math
import warnings

import numpy as np
from scipy.integrate import solve_ivp

from pmabench.model.curve import Array
from pmabench.model.library import daerden
from pmabench.model.library.braid import BAR
from pmabench.model.library.daerden import ATMOSPHERE, CM3, CONTRACTION, MUSCLE
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse

FAMILY = "chamber"
R = 287.0
"""Gas constant of air [J/(kg K)] (paper 3)."""

PRESSURE = Parameter("pressure", "P", "pressure", 5 * BAR, "gauge pressure", 0.0, 2e6, "no pressure of a muscle")
VOLUME = Parameter("volume", "V", "volume", 62.832 * CM3, "volume of the gas", 0.0, above=True)
POLYTROPIC = Parameter(
    "polytropic", "k", "count", 1.2, "exponent: 1 isothermal, 1.4 adiabatic", 1.0, 1.4,
    "between isothermal and adiabatic",
)  # fmt: skip
TEMPERATURE = Parameter("temperature", "T", "temperature", 293.0, "of the air", 200.0, 400.0, "no air of a bench")


@described(
    "chamber-rate", FAMILY, "Rate of pressure from flow and change of volume",
    equation=(
        "dP/dt = [-(k P_abs / V) V_eps eps' + (k r T / V) (q_in - q_out)] / (1 + (k P_abs / V) V_P)",
        "P_abs = P + P_atm;  r = 287 J/(kg K)",
    ),
    source="paper 3, chamber equation",
    parameters=(
        PRESSURE, VOLUME,
        Parameter("volume_slope", "V_eps", "volume", 271.0 * CM3, "dV/deps"),
        Parameter("contraction_rate", "eps'", "rate", 0.0, "rate of contraction"),
        Parameter("inflow", "q_in", "mass flow", 1e-3, "air that comes in", 0.0, INF, "it comes in"),
        Parameter("outflow", "q_out", "mass flow", 0.0, "air that goes out", 0.0, INF, "it goes out"),
        Parameter("volume_compliance", "V_P", "volume per pressure", 0.0, "dV/dP at constant eps", 0.0),
        POLYTROPIC, TEMPERATURE, ATMOSPHERE,
    ),
    outputs=(Output("pressure_rate", "dP/dt", "pressure rate", "rate of the pressure"),),
    references=(
        Reference("pressure_rate", "1606.0", "kPa/s", 1e3, "by hand: 1.2 287 293 1e-3 / 62.832e-6"),
        Reference("pressure_rate", "-311.23", "kPa/s", 1e3, "by hand: -1.2 601325 (271 / 62.832) 0.1",
                  {"inflow": 0.0, "contraction_rate": 0.1}),
    ),
    notes=("Pressure in the gas law is absolute; the model takes gauge pressure and adds the room's.",),
)  # fmt: skip
def chamber_rate(
    pressure: Array,
    volume: Array,
    volume_slope: Array,
    contraction_rate: Array,
    inflow: Array,
    outflow: Array,
    volume_compliance: Array,
    polytropic: Array,
    temperature: Array,
    atmosphere: Array,
) -> Values:
    """dP/dt [Pa/s]; P and P_atm [Pa], V and V_eps [m3], eps' [1/s], flows [kg/s], V_P [m3/Pa], k [1], T [K]."""
    stiff = polytropic * (pressure + atmosphere) / volume
    flow = polytropic * R * temperature / volume * (inflow - outflow)
    return {"pressure_rate": (flow - stiff * volume_slope * contraction_rate) / (1 + stiff * volume_compliance)}


@described(
    "closed-chamber", FAMILY, "Pressure of a closed chamber whose volume changes",
    equation=("P + P_atm = (P0 + P_atm) (V0 / V)^k",),
    source="paper 3, chamber equation without flow, integrated",
    parameters=(
        Parameter("pressure_start", "P0", "pressure", 3 * BAR, "gauge pressure at V0", 0.0, 2e6),
        Parameter("volume_start", "V0", "volume", 62.832 * CM3, "volume at P0", 0.0, above=True),
        VOLUME, POLYTROPIC, ATMOSPHERE,
    ),
    outputs=(Output("pressure", "P", "pressure", "gauge pressure"),),
    references=(
        Reference("pressure", "300.000", "kPa", 1e3, "the same volume"),
        Reference("pressure", "73.362", "kPa", 1e3, "by hand: 401.325 / 2^1.2 - 101.325", {"volume": 125.664 * CM3}),
    ),
)  # fmt: skip
def closed_chamber(
    pressure_start: Array, volume_start: Array, volume: Array, polytropic: Array, atmosphere: Array
) -> Values:
    """P [Pa gauge] from P0 [Pa gauge], V0 and V [m3], k [1], P_atm [Pa absolute]."""
    return {"pressure": (pressure_start + atmosphere) * (volume_start / volume) ** polytropic - atmosphere}


@described(
    "driven-chamber", FAMILY, "Pressure and force of a muscle driven in a sine behind a regulator that has to move air",
    equation=(
        "eps = middle - half cos(2 pi f t), from contraction_low to contraction_high; P(0) = P_set",
        "q = C_fill (P_set - P) where P < P_set, C_vent (P_set - P) above; dP/dt as in chamber-rate with V_P = 0",
        "V as in daerden-volume; F as in daerden-force",
    ),
    source="paper 3, sinusoidal test; the regulator as two conductances is assumed",
    parameters=(
        Parameter("time", "t", "time", 5.0, "since the start", 0.0, 100.0, "longer takes too long to compute"),
        Parameter("frequency", "f", "frequency", 0.1, "of the sine", 0.0, 3.0, "paper 3 goes to 3 Hz", above=True),
        Parameter("contraction_low", "eps_low", "ratio", -0.03, "lowest contraction", -0.03, 0.2, CONTRACTION.reason),
        Parameter("contraction_high", "eps_high", "ratio", 0.2, "highest contraction", -0.03, 0.2, CONTRACTION.reason),
        Parameter("pressure_set", "P_set", "pressure", 5 * BAR, "set pressure, gauge", 0.0, 1e6),
        Parameter("conductance_fill", "C_fill", "conductance", 1e-7, "while filling", 0.0, INF, "", "assumed"),
        Parameter("conductance_vent", "C_vent", "conductance", 0.5e-7, "while venting", 0.0, INF, "", "assumed"),
        *MUSCLE, POLYTROPIC, TEMPERATURE, ATMOSPHERE,
    ),
    outputs=(
        Output("contraction", "eps", "ratio", "contraction"),
        Output("pressure", "P", "pressure", "gauge pressure in the muscle"),
        Output("pressure_error", "P - P_set", "pressure", "what an ideal source would not show"),
        Output("volume", "V", "volume", "volume"),
        Output("force", "F", "force", "force with the pressure in the muscle, without hysteresis"),
    ),
    references=(
        Reference("volume", "152.0", "cm3", CM3, "table of the assumed muscle: V at 20 %"),
        Reference("contraction", "20.0", "%", 0.01, "closed form: half a period"),
    ),
    notes=(
        "Contracting the pressure falls, expanding it rises more, because venting is slower: the paper's model with an "
        "ideal source was bad only while expanding.",
        "3 Hz at full stroke and 5 bar reaches 7 bar, above the 6 bar that a muscle may have: not a test to run.",
    ),
)  # fmt: skip
def driven_chamber(
    time: Array, frequency: Array, contraction_low: Array, contraction_high: Array, pressure_set: Array, *rest: Array
) -> Values:
    """Eps [1], P and P - P_set [Pa], V [m3], F [N] at t [s]; others SI as listed, P_set gauge."""
    refuse("contraction_high", "it must be above contraction_low", contraction_high <= contraction_low)
    fill, vent, diameter, length, braid_angle, alpha, A, B1, B2, *air = rest
    t, *inputs = np.broadcast_arrays(
        time, frequency, contraction_low, contraction_high, pressure_set, fill, vent,
        diameter, length, braid_angle, alpha, *air,
    )  # fmt: skip
    cases = np.stack([np.ravel(item) for item in inputs], axis=1)
    moments, pressure = np.ravel(t), np.empty(t.size)
    for case in np.unique(cases, axis=0):
        rows = (cases == case).all(axis=1)
        pressure[rows] = _pressure_driven(moments[rows], *map(float, case))
    P = pressure.reshape(t.shape)
    middle, half = (contraction_low + contraction_high) / 2, (contraction_high - contraction_low) / 2
    eps = middle - half * np.cos(2 * math.pi * frequency * time)
    eps = np.clip(eps, contraction_low, contraction_high)
    force = daerden.section_factor(eps, diameter, braid_angle, alpha) * P + daerden.rubber_force(eps, A, B1, B2)
    volume = daerden.muscle_volume(eps, diameter, length, braid_angle, alpha)
    return {"contraction": eps, "pressure": P, "pressure_error": P - pressure_set, "volume": volume, "force": force}


def _pressure_driven(
    t: Array, f: float, low: float, high: float, wanted: float, fill: float, vent: float, *rest: float
) -> Array:
    """Gauge pressure [Pa] at any times t [s]; `rest` is D0, l0, theta0, alpha, k, T, P_atm."""
    D0, l0, theta0, alpha, k, T, room = rest
    size = math.pi / 4 * D0**2 * l0
    round_, straight = 1 / math.sin(theta0) ** 2, 1 / math.tan(theta0) ** 2
    omega, half = 2 * math.pi * f, (high - low) / 2

    def rate(s: float, state: Array) -> list[float]:
        eps = (low + high) / 2 - half * math.cos(omega * s)
        shape = straight * (1 - eps) ** alpha
        volume, slope = size * (round_ - shape) * (1 - eps), size * ((alpha + 1) * shape - round_)
        error = wanted - float(state[0])
        flow = (fill if error > 0 else vent) * error
        grow = slope * half * omega * math.sin(omega * s)
        return [k * (R * T * flow - (float(state[0]) + room) * grow) / volume]

    moments, back = np.unique(t, return_inverse=True)
    if moments[-1] == 0:
        return np.full(t.shape, wanted)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a failure is reported by the refusal below
        solved = solve_ivp(
            rate, (0.0, float(moments[-1])), [wanted], "LSODA", moments, rtol=1e-8, atol=1e-3, max_step=0.02 / f
        )
    refuse(
        "length",
        "air moves too fast for so small a volume to be integrated: a larger one is expected",
        not solved.success,
    )
    return np.asarray(solved.y[0][back], dtype=np.float64)
