"""Pressure in a muscle's chamber, and the response of regulators to a commanded step or sine.

Chamber: rate from flow and volume, closed chamber, and a driven muscle behind a regulator. Regulators: lags, limits of
rate and flow, different for filling and venting.
"""

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

FAMILY, REGULATOR = "chamber", "regulator"
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


TIME = Parameter("time", "t", "time", 0.22, "since the command", 0.0, INF, "the command is at 0")
START = Parameter("start", "P0", "pressure", 0.0, "gauge pressure before", 0.0, 1e6)
TARGET = Parameter("target", "P1", "pressure", 3 * BAR, "commanded gauge pressure", 0.0, 1e6)
DEAD_TIME = Parameter("dead_time", "t_d", "time", 0.0, "before anything happens", 0.0)
LAG = Parameter("lag", "T", "time", 0.0955, "time constant while filling", 0.0, 1e3, "", "0.22 s as 90 % time, paper 0")
ANSWER = Output("pressure", "P", "pressure", "gauge pressure")
RATE_FILL = Parameter("rate_fill", "R_fill", "pressure rate", 28 * BAR, "most while filling", 0.0, above=True)
RATE_VENT = Parameter("rate_vent", "R_vent", "pressure rate", 28 * BAR, "most while venting", 0.0, above=True)


def limited_step(since: Array, step: Array, lag: Array, rate: Array) -> Array:
    """Response of a first-order `lag` [s] with limited `rate` [units/s], `since` >= 0 [s] after a `step` of any sign.

    A ramp at the limit until the remaining step / lag is below it, then the exponential; a lag of 0 gives the ramp
    alone.
    """
    size = np.abs(step)
    ramp_until = np.maximum(size / rate - lag, 0)
    left = size - rate * ramp_until
    fade = np.exp(-np.maximum(since - ramp_until, 0) / np.where(lag > 0, lag, 1))
    settled = np.where(lag > 0, size - left * fade, size)
    return np.asarray(np.sign(step) * np.where(since < ramp_until, rate * since, settled))


@described(
    "regulator-first-order", REGULATOR, "First-order lag with dead time, slower or faster while venting",
    equation=(
        "P = P0 + (P1 - P0) (1 - exp(-(t - t_d) / T)) from t_d on;  T times vent_ratio where P1 < P0",
        "90 % of the step at t90 = t_d + T ln 10",
    ),
    source="paper 0, MPPE regulator: 0.22 s of no stated definition, 90 % of the step (T = 0.0955 s) or T itself",
    fitted=("lag", "dead_time"),
    parameters=(
        TIME, START, TARGET, LAG,
        Parameter("vent_ratio", "", "count", 1.0, "T while venting by T while filling", 0.0, above=True),
        DEAD_TIME,
    ),
    outputs=(ANSWER, Output("t90", "t90", "time", "when 90 % of the step is done")),
    references=(
        Reference("t90", "0.22", "s", 1.0, "response printed in paper 0"),
        Reference("pressure", "63.212", "kPa", 1e3, "closed form: 1 - 1/e of 100 kPa",
                  {"time": 0.1, "lag": 0.1, "target": 1e5}),
        Reference("pressure", "51.342", "kPa", 1e3, "closed form: 100 exp(-1 / 1.5) while venting",
                  {"time": 0.1, "lag": 0.1, "start": 1e5, "target": 0.0, "vent_ratio": 1.5}),
    ),
)  # fmt: skip
def regulator_first_order(
    time: Array, start: Array, target: Array, lag: Array, vent_ratio: Array, dead_time: Array
) -> Values:
    """P [Pa gauge] and t90 [s] from t [s], P0 and P1 [Pa gauge], T [s], vent_ratio [1], t_d [s]."""
    T = np.where(target < start, lag * vent_ratio, lag)
    since = np.maximum(time - dead_time, 0)
    fade = np.where(T > 0, np.exp(-since / np.where(T > 0, T, 1)), (time < dead_time) * 1.0)
    return {"pressure": target + (start - target) * fade, "t90": dead_time + T * math.log(10)}


@described(
    "regulator-second-order", REGULATOR, "Second-order lag with dead time: may overshoot",
    equation=("P'' + 2 zeta w P' + w^2 P = w^2 P1(t - t_d);  w = 2 pi f_n;  from rest at P0",),
    source="closed form of the linear equation; usual for servo valves",
    fitted=("natural_frequency", "damping_ratio", "dead_time"),
    parameters=(
        TIME, START, TARGET,
        Parameter("natural_frequency", "f_n", "frequency", 4.0, "without damping", 0.0, above=True),
        Parameter("damping_ratio", "zeta", "count", 0.7, "1 is critical", 0.0),
        DEAD_TIME,
    ),
    outputs=(ANSWER, Output("overshoot", "", "ratio", "of the step; 0 from zeta = 1 on")),
    references=(
        Reference("pressure", "26.424", "kPa", 1e3, "closed form: 1 - 2/e of 100 kPa, zeta = 1, w t = 1",
                  {"damping_ratio": 1.0, "natural_frequency": 1 / (2 * math.pi), "time": 1.0, "target": 1e5}),
        Reference("overshoot", "16.303", "%", 0.01, "closed form: exp(-pi / sqrt 3)", {"damping_ratio": 0.5}),
    ),
)  # fmt: skip
def regulator_second_order(
    time: Array, start: Array, target: Array, natural_frequency: Array, damping_ratio: Array, dead_time: Array
) -> Values:
    """P [Pa gauge] and overshoot [1] from t [s], P0 and P1 [Pa gauge], f_n [Hz], zeta [1], t_d [s]."""
    zeta = damping_ratio
    angle = 2 * math.pi * natural_frequency * np.maximum(time - dead_time, 0)
    root = np.sqrt(np.abs(1 - zeta**2))
    # for root -> 0 both forms approach the critical one: sin(root angle) / root -> angle
    wave = np.sinc(root * angle / math.pi) * angle
    under = np.exp(-zeta * angle) * (np.cos(root * angle) + zeta * wave)
    slow, fast = zeta - root, zeta + root
    over = (fast * np.exp(-slow * angle) - slow * np.exp(-fast * angle)) / np.where(root > 0, 2 * root, 1)
    left = np.where(zeta > 1, over, under)
    beyond = np.where(zeta < 1, np.exp(-math.pi * zeta / np.where(zeta < 1, root, 1)), 0.0)
    return {"pressure": target + (start - target) * left, "overshoot": beyond}


@described(
    "regulator-rate-limited", REGULATOR, "First-order lag whose rate of pressure is limited, filling and venting",
    equation=(
        "|dP/dt| = min(|P1 - P| / T, R):  a ramp until |P1 - P| = R T, then the exponential",
        "R = R_fill or R_vent by the direction of the step",
    ),
    source="closed form; the rate as in the sines of the public data set mit-2-151",
    fitted=("lag",),
    parameters=(TIME, START, TARGET, LAG, RATE_FILL, RATE_VENT, DEAD_TIME),
    outputs=(ANSWER,),
    references=(
        Reference("pressure", "100.000", "kPa", 1e3, "by hand: 10 bar/s for 0.1 s",
                  {"rate_fill": 10 * BAR, "time": 0.1}),
        Reference("pressure", "263.212", "kPa", 1e3, "by hand: ramp to 200 kPa, then 1 - 1/e of 100 kPa",
                  {"rate_fill": 10 * BAR, "time": 0.3, "lag": 0.1}),
    ),
)  # fmt: skip
def regulator_rate_limited(
    time: Array, start: Array, target: Array, lag: Array, rate_fill: Array, rate_vent: Array, dead_time: Array
) -> Values:
    """P [Pa gauge] from t [s], P0 and P1 [Pa gauge], T [s], rates [Pa/s], t_d [s]."""
    rate = np.where(target < start, rate_vent, rate_fill)
    return {"pressure": start + limited_step(np.maximum(time - dead_time, 0), target - start, lag, rate)}


@described(
    "regulator-flow-limited", REGULATOR, "A volume filled through a conductance up to a largest flow, vented likewise",
    equation=(
        "q = min(C |P1 - P|, q_max);  dP/dt = (k r T / V) q",
        "so lag = V / (k r T C) and rate = k r T q_max / V in regulator-rate-limited",
    ),
    source="paper 3, chamber equation at constant volume",
    parameters=(
        Parameter("time", "t", "time", 0.1, "since the command", 0.0, INF, "the command is at 0"),
        START, TARGET, VOLUME,
        Parameter(
            "conductance_fill", "C_fill", "conductance", 1e-7, "while filling", 0.0, INF, "", "assumed",
            above=True,
        ),
        Parameter(
            "conductance_vent", "C_vent", "conductance", 0.5e-7, "while venting", 0.0, INF, "", "assumed",
            above=True,
        ),
        Parameter("flow_fill", "q_fill", "mass flow", 2e-3, "largest flow in", 0.0, above=True),
        Parameter("flow_vent", "q_vent", "mass flow", 1e-3, "largest flow out", 0.0, above=True),
        POLYTROPIC, TEMPERATURE, DEAD_TIME,
    ),
    outputs=(
        ANSWER,
        Output("lag", "T", "time", "V / (k r T C) in the direction of the step"),
        Output("rate", "R", "pressure rate", "largest rate in that direction"),
    ),
    references=(
        Reference("lag", "0.0062266", "s", 1.0, "by hand: 62.832e-6 / (1.2 287 293 1e-7)"),
        Reference("rate", "3212.0", "kPa/s", 1e3, "by hand: 1.2 287 293 2e-3 / 62.832e-6"),
    ),
)  # fmt: skip
def regulator_flow_limited(
    time: Array,
    start: Array,
    target: Array,
    volume: Array,
    conductance_fill: Array,
    conductance_vent: Array,
    flow_fill: Array,
    flow_vent: Array,
    polytropic: Array,
    temperature: Array,
    dead_time: Array,
) -> Values:
    """P [Pa gauge], lag [s], rate [Pa/s]; pressures [Pa gauge], V [m3], C [kg/s/Pa], flows [kg/s], k [1], T [K]."""
    vents = target < start
    per_flow = polytropic * R * temperature / volume
    lag = 1 / (per_flow * np.where(vents, conductance_vent, conductance_fill))
    rate = per_flow * np.where(vents, flow_vent, flow_fill)
    since = np.maximum(time - dead_time, 0)
    return {"pressure": start + limited_step(since, target - start, lag, rate), "lag": lag, "rate": rate}


@described(
    "regulator-sine", REGULATOR, "A sine behind a limit of rate: gain and phase that depend on the amplitude",
    equation=(
        "P follows A sin(w t) where it can, else with rate R; gain and phase of the first harmonic",
        "A w <= R: gain 1. A w >= 1.862 R: a triangle of peak pi R / (2 w), gain 4 R / (pi A w), phase -acos(pi R / "
        "(2 A w))",
    ),
    source=(
        "describing function of a rate limiter; in the public data set mit-2-151 sines of 3 bar fall off like this "
        "from 9 rad/s on, with R about 28 bar/s and 40 ms of dead time"
    ),
    parameters=(
        Parameter("amplitude", "A", "pressure", 3 * BAR, "of the commanded sine", 0.0, above=True),
        Parameter("frequency", "f", "frequency", 5.0, "of the sine", 0.0, above=True),
        Parameter("rate", "R", "pressure rate", 28 * BAR, "most that the regulator makes", 0.0, above=True),
        DEAD_TIME,
    ),
    outputs=(
        Output("gain", "", "count", "amplitude of the first harmonic by A"),
        Output("phase", "", "angle", "of the first harmonic, below 0: late"),
        Output("answer", "", "pressure", "amplitude of the first harmonic"),
    ),
    references=(
        Reference("answer", "113.48", "kPa", 1e3, "closed form of the triangle: 4 28 bar/s / (pi 2 pi 5 Hz)"),
        Reference("phase", "-62.18", "deg", math.pi / 180, "closed form of the triangle: -acos(1.4 / 3)"),
        Reference("gain", "1.0000", "", 1.0, "closed form: not limited", {"amplitude": 0.5 * BAR}),
    ),
    notes=(
        "A lag alone has one gain for all amplitudes; what a small sine shows says nothing of a large one.",
        "Held against seven frequencies of that data set: gain within 0.09, phase within 8 deg.",
    ),
)  # fmt: skip
def regulator_sine(amplitude: Array, frequency: Array, rate: Array, dead_time: Array) -> Values:
    """Gain [1], phase [rad], answer [Pa] from A [Pa], f [Hz], R [Pa/s], t_d [s]."""
    ease = rate / (2 * math.pi * frequency * amplitude)
    harmonic = np.vectorize(_limited_harmonic, otypes=[complex])(ease)
    gain = np.abs(harmonic)
    phase = np.angle(harmonic) - 2 * math.pi * frequency * dead_time
    return {"gain": gain + 0 * phase, "phase": phase, "answer": gain * amplitude}


def _limited_harmonic(ease: float) -> complex:
    """First harmonic of sin(theta) with its slope limited to `ease` = R / (A w); 1 is the sine itself."""
    if ease >= 1:
        return 1 + 0j
    if ease <= 1 / math.sqrt(1 + math.pi**2 / 4):
        peak = math.pi * ease / 2
        return complex(4 * ease / math.pi * np.exp(-1j * math.acos(peak)))
    leave = -math.acos(ease)
    theta = leave + np.linspace(0, math.pi, 20001)
    ramp = math.sin(leave) + ease * (theta - leave)
    meets = np.flatnonzero((ramp >= np.sin(theta)) & (theta > 0))
    wave = np.where(theta < theta[meets[0]] if meets.size else True, ramp, np.sin(theta))
    return complex(2j / math.pi * np.trapezoid(wave * np.exp(-1j * theta), theta))
