"""Made-up analyses and runs of the plant paper0, in the shape that the reductions give; nothing is fitted here."""

from __future__ import annotations

import numpy as np

from pmabench.kinds.registry import kind_of
from pmabench.report.document.content import content_of, page_of
from pmabench.store.analyses.results import Analysis, Curve, Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.records import ChannelInfo, Event, RunData, TrialData

PRESSURES = tuple(np.arange(150e3, 501e3, 50e3))
RUNS = {
    kind: f"20261121-0915_MAS-20-250-A017_{kind}_SIMULATED_{n:04x}"
    for n, kind in enumerate(("static-load", "contraction-relaxation", "sinusoidal-displacement", "ultimate-gain"), 1)
}
UNITS = {"F_ce": ("N", "force"), "K": ("N/m", "stiffness"), "B_c": ("N.s/m", "damping"), "B_r": ("N.s/m", "damping")}


def truth(symbol: str, P: float) -> float:
    """Plant 5.1, SI."""
    p = P / 1e3
    return {
        "F_ce": 1.08 * p - 49.0,
        "K": 1e3 * (5.6 + 1.0e-3 * p + 9.7e-6 * p * p),
        "B_c": 1e3 * (1.2 + 1.6e-3 * p),
        "B_r": 1e3 * (1.1 + 3.4e-3 * p),
    }[symbol]


def estimate(symbol, value, method, at=None, half=0.003, **more) -> Estimate:
    unit, quantity = more.pop("kind", UNITS.get(symbol, ("1", "count")))
    size = abs(value or 0.0) * half
    parts = Parts(repeats=0.8 * size, method=0.6 * size, calibration=None) if value is not None else Parts()
    return Estimate(symbol, value, unit, quantity, method, at or {}, more.pop("parts", parts), n=5, **more)


def contraction(simulated: bool = True) -> Analysis:
    run = RUNS["contraction-relaxation"]
    estimates = []
    for symbol in UNITS:
        for P in PRESSURES:
            gone = symbol == "B_r" and P > 460e3
            value = None if gone else truth(symbol, P)
            note = "not identifiable: no relaxing samples near this pressure" if gone else ""
            estimates.append(estimate(symbol, value, "measured-pressure", {"pressure": P}, note=note))
    for symbol in UNITS:
        for P in PRESSURES[2:]:
            value = truth(symbol, P) * (1.12 if symbol[0] == "B" else 1.0)
            estimates.append(estimate(symbol, value, "step-exponential", {"pressure": P}, half=0.05))
    # the worked example of the brief: 7.552 +- 0.021
    K = next(i for i, e in enumerate(estimates) if e.symbol == "K" and e.at["pressure"] == 400e3)
    exact = Parts(repeats=0.021e3)
    estimates[K] = estimate("K", 7.552e3, "measured-pressure", {"pressure": 400e3}, parts=exact)
    estimates.append(estimate("F_c", 6.0, "measured-pressure", kind=("N", "force")))
    for P in PRESSURES:
        at = {"pressure": P}
        more = {"kind": ("s", "time"), "coordinate": "command-to-motion"}
        estimates.append(estimate("t_d", 0.05 + 4e3 / P, "onset", at, half=0.05, **more))
    terms = tuple(
        estimate("K", value, "measured-pressure", kind=kind, coordinate=name)
        for value, kind, name in (
            (5600.0, ("N/m", "stiffness"), "intercept"),
            (1.0e-3, ("N/m/Pa", "stiffness per pressure"), "slope"),
            (9.7e-9, ("N/m/Pa2", "stiffness per pressure squared"), "quadratic"),
        )
    )
    curve = Curve("K", "quadratic", terms, "pressure", (150e3, 500e3), 0.99999, 0.5, "measured-pressure")
    t = np.arange(0.0, 20.0, 0.02)
    traces = []
    for P, load in ((200e3, 58.86), (300e3, 58.86), (400e3, 157.0), (500e3, 255.0)):
        x = (truth("F_ce", P) - load) / truth("K", P) * (1 - np.exp(-t / 0.25))
        columns = {"t": t, "pressure": np.full(len(t), P), "displacement": x + 2e-6 * np.sin(37 * t), "model": x}
        quantities = {"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"}
        name = f"overlay-{P / 1e3:.0f}kPa-{load:.0f}N"
        title = f"{P / 1e3:.0f} kPa, {load:g} N: measured and fitted muscle"
        traces.append(Trace(name, "overlay", title, columns, quantities, {"pressure": P, "load": load}))
    return Analysis(
        kind="contraction-relaxation",
        runs=(run,),
        simulated=simulated,
        estimates=tuple(estimates),
        curves=(curve,),
        dropped=(
            Dropped(f"{run}/15", {"pressure": 150e3, "load": 157.0}, "the load, 157 N, is not below F_ce = 113 N"),
        ),
        findings=(
            Finding("note", "residual 0.13 N rms over 2509 segments"),
            Finding("doubt", "step-exponential against measured-pressure: B_c +12 %"),
        ),
        traces=tuple(traces),
        facts={"trials": 80, "trials_used": 46, "options": {}},
        results=kind_of("contraction-relaxation").results,
    )


def static_load(simulated: bool = True) -> Analysis:
    loads = np.array([58.86, 156.96, 255.06, 353.16, 451.26])
    P = (loads + 49.0) / 1.08e-3
    estimates = [estimate("F_ce", truth("F_ce", p), "static-mean", {"pressure": p}) for p in PRESSURES]
    columns = {"load": loads, "lift": P + 9e3, "set_down": P - 9e3}
    quantities = {"load": "force", "lift": "pressure", "set_down": "pressure"}
    points = Trace("static-load", "static", "Pressure at which each load lifts and sets down", columns, quantities)
    t = np.linspace(0, 30, 400)
    lift = Trace(
        "lift-59N",
        "lift",
        "58.86 N: lift and set-down",
        {"t": t, "pressure": 4e3 * t, "displacement": np.where(t > 25, 5e-4, 0.0)},
        {"t": "time", "pressure": "pressure", "displacement": "length"},
        {"load": 58.86, "lift": P[0] + 9e3, "set-down": P[0] - 9e3},
    )
    line = Curve(
        "F_ce",
        "line",
        (
            estimate("F_ce", -49.0, "static-mean", kind=("N", "force"), coordinate="intercept"),
            estimate("F_ce", 1.08e-3, "static-mean", kind=("N/Pa", "force per pressure"), coordinate="slope"),
        ),
        "pressure",
        (100e3, 460e3),
        0.9999,
        0.3,
        "static-mean",
    )
    runs = (RUNS["static-load"],)
    return Analysis(
        "static-load",
        runs,
        simulated,
        tuple(estimates),
        (line,),
        traces=(points, lift),
        facts={"trials": 12},
        results=kind_of("static-load").results,
    )


def sine(simulated: bool = True) -> Analysis:
    at = {"pressure": 300e3, "mean": 0.03, "amplitude": 0.01}
    frequencies = np.array([0.1, 0.5, 1.0, 3.0])
    K, B, F_c = 6773.0, 1900.0, 6.0
    estimates = [
        estimate("K", K, "sine-harmonic", at),
        estimate("B", B, "sine-harmonic", at, kind=("N.s/m", "damping")),
        estimate("B", 1.01 * B, "loop-width", at, kind=("N.s/m", "damping")),
    ]
    traces = []
    for f in frequencies:
        w = 2 * np.pi * f
        estimates.append(estimate("K", K, "sine-harmonic", {**at, "frequency": f}))
        phase = np.linspace(0, 2 * np.pi, 200)
        x, v = 0.03 + 0.01 * np.sin(phase), 0.01 * w * np.cos(phase)
        F = 275.0 - K * x - B * v - F_c * np.sign(v)
        columns = {"displacement": x, "force": F + 0.2 * np.sin(17 * phase), "model": F}
        marks = {"frequency": f, "width": 2 * B * 0.01 * w + 2 * F_c, "area": 1.0}
        quantities = {"displacement": "length", "force": "force", "model": "force"}
        traces.append(Trace(f"loop-300-{f:g}", "loop", f"Loop at {f:g} Hz, 300 kPa, 30 mm", columns, quantities, marks))
    speed = 2 * np.pi * frequencies * 0.01
    loss = B * speed + 4 * F_c / np.pi
    columns = {
        "frequency": frequencies,
        "gain": np.hypot(K, loss / 0.01),
        "phase": np.arctan2(loss / 0.01, K),
        "stiffness": np.full(4, K),
        "loss": loss,
        "speed": speed,
        "width": 2 * B * speed + 2 * F_c,
    }
    names = {"gain": "stiffness", "phase": "angle", "loss": "force", "width": "force"}
    quantities = {name: names.get(name, name) for name in columns}
    traces.append(
        Trace("bode-300", "bode", "Force over displacement, 300 kPa", columns, quantities, {"K": K, "B": B, "F_c": F_c})
    )
    runs = (RUNS["sinusoidal-displacement"],)
    return Analysis(
        "sinusoidal-displacement",
        runs,
        simulated,
        tuple(estimates),
        traces=tuple(traces),
        facts={"trials": 12},
        results=kind_of("sinusoidal-displacement").results,
    )


def ultimate_gain(simulated: bool = True) -> Analysis:
    estimates, settings, traces = [], [], []
    for setpoint, K_u, T_u in ((0.01, 46.8e6, 0.352), (0.03, 59.9e6, 0.355), (0.06, 200.0e6, 0.34)):
        at = {"setpoint": setpoint, "load": 0.0}
        estimates.append(estimate("K_u", K_u, "gain-steps", at, kind=("Pa/m", "gain")))
        estimates.append(estimate("T_u", T_u, "gain-steps", at, kind=("s", "time")))
        for name, factor in (("P", 0.5), ("PI", 0.45)):
            gains = {"K_p": estimate("K_p", factor * K_u, f"Ziegler-Nichols {name}", at, kind=("Pa/m", "gain"))}
            if name == "PI":
                gains["T_i"] = estimate("T_i", T_u / 1.2, "Ziegler-Nichols PI", at, kind=("s", "time"))
                kind = ("Pa/(m.s)", "integral gain")
                gains["K_i"] = estimate("K_i", 0.45 * K_u * 1.2 / T_u, "Ziegler-Nichols PI", at, kind=kind)
            settings.append(
                {
                    "at": at,
                    "rule": f"Ziegler-Nichols {name}",
                    "name": "Ziegler-Nichols",
                    "form": name,
                    "source": "Ziegler and Nichols 1942",
                    "gains": {key: e.to_dict() for key, e in gains.items()},
                    "margins": {"gain_margin": 2.0, "phase_margin": 0.59, "M_s": None, "stable": True},
                }
            )
        t = np.linspace(0, 4, 500)
        x = setpoint + 4e-4 * np.sin(2 * np.pi * t / T_u)
        marks = {"setpoint": setpoint, "K_u": K_u}
        where = f"set-point {setpoint * 1e3:g} mm"
        traces.append(
            Trace(
                f"oscillation-{setpoint:g}-0",
                "oscillation",
                f"Oscillation nearest to the ultimate gain, {where}",
                {"t": t, "displacement": x, "pressure_command": 2e5 - K_u * (x - setpoint)},
                {"t": "time", "displacement": "length", "pressure_command": "pressure"},
                marks,
            )
        )
        gain = K_u * np.linspace(0.6, 1.05, 10)
        ratio = 1.1 * (gain / K_u - 1)
        columns = {"gain": gain, "log_ratio": ratio, "fit": ratio, "period": np.full(10, T_u), "used": ratio > -0.2}
        columns = {name: np.asarray(values, dtype=float) for name, values in columns.items()}
        quantities = {"gain": "gain", "log_ratio": "count", "fit": "count", "period": "time", "used": "count"}
        title = f"Growth per half period, {where}"
        traces.append(Trace(f"growth-{setpoint:g}-0", "growth", title, columns, quantities, {"K_u": K_u}))
    findings = (
        Finding("note", "K_u at 30 mm: 7.1 bar/cm (open-loop), 7.2 bar/cm (relay-fit); the ways are 1.4% apart"),
    )
    return Analysis(
        kind="ultimate-gain",
        runs=(RUNS["ultimate-gain"],),
        simulated=simulated,
        estimates=tuple(estimates),
        findings=findings,
        traces=tuple(traces),
        facts={"trials": 9, "tuning": settings},
        results=kind_of("ultimate-gain").results,
    )


def all_analyses(simulated: bool = True) -> list[Analysis]:
    return [static_load(simulated), contraction(simulated), sine(simulated), ultimate_gain(simulated)]


def run(kind: str, simulated: bool = True, **manifest) -> RunData:
    """A run with a manifest as the engine writes it, and two trials without samples."""
    empty = np.empty(0)
    trials = tuple(
        TrialData(
            RUNS[kind],
            i,
            {"pressure": P, "load": 58.86},
            0,
            False,
            "finished",
            empty,
            {},
            np.empty(0, np.uint16),
            (),
            {},
        )
        for i, P in enumerate((150e3, 200e3))
    )
    reported = {
        "protocol": f"{kind}, MAS-20-250",
        "source": "paper 0",
        "bench": "mock bench",
        "specimen": {"make": "Festo", "type": "MAS-20-250N-AA-MC-K", "serial": "A017", "nominal_length": 0.25},
        "operator": "demo",
        "started_utc": "2026-11-21T09:15:19.376+00:00",
        "devices": {"plant": {"maker": "pmabench", "model": "mock", "serial": "1", "firmware": "1"}},
        "plan_sha256": "0" * 64,
        "trials_planned": 2,
        "versions": {"python": "3.11.7", "pmabench": "0.1.0"},
        "end": {"counts": {"rows": 1000, "gaps": 3}, "vent": {"result": "confirmed"}},
        "lacks": ["no dump valve"],
    }
    channel = ChannelInfo("pressure", "pressure", "Pa", 1.0, 0.0, 0.0, 1e6, 1.5e3, 0.002, 0.001, "CAL-P-7")
    accept = (
        {"accept": {"limits": [{"what": "K", "measure": "relative_interval", "limit": 0.02}]}}
        if kind == "contraction-relaxation"
        else {}
    )
    answer = Event(0, 0.2, "answer", {"answer": "confirmed beforehand (--yes)"})
    return RunData(
        id=RUNS[kind],
        path="",
        kind=kind,
        status="finished",
        simulated=simulated,
        manifest={**reported, **manifest},
        plan=accept,
        events=(answer,),
        channels={"pressure": channel},
        rate=500.0,
        trials=trials,
    )


def all_runs(simulated: bool = True) -> list[RunData]:
    return [run(kind, simulated) for kind in RUNS]


def render(analyses, runs, **options) -> str:
    """The HTML page of a report."""
    return page_of(content_of(analyses, runs, **options))
