"""An archive of generated runs: each a step of pressure of 10 s at 500 Hz over six channels, known K and B behind it."""

from dataclasses import asdict

import numpy as np

from pmabench.bench.interface import CalibrationRecord, ChannelRecord, Scale
from pmabench.store.writer import RunWriter

RATE, ROWS, AT = 500.0, 5000, 2.0
MASS, STROKE_PER_PRESSURE = 7.85, 2.0e-7
"""Moving mass [kg] and stroke per pressure [m/Pa]."""
DEAD, LAG = 0.020, 0.050
"""Dead time and time constant of the regulator [s]."""
LATE = [0.0, 0.005]
"""How much older the pressure may be than its stamps [s]; little enough for K and B from its ringing."""
FROM, TO = 100e3, 300e3
SCALES = {
    "pressure": ("pressure", Scale(25.0, 0.0)),
    "displacement": ("length", Scale(2e-6, 0.0)),
    "force": ("force", Scale(0.05, 0.0)),
    "pressure_command": ("pressure", Scale(25.0, 0.0)),
    "supply": ("pressure", Scale(25.0, 0.0)),
    "temperature": ("count", Scale(0.01, 0.0)),
}


def stiffness_and_damping(number):
    """K [N/m] and B [N.s/m] behind run `number`."""
    return 7000.0 + 40.0 * (number % 50), 60.0 + 0.5 * (number % 40)


def samples(number, rows=ROWS):
    """Times [s] and SI values of run `number`: a lag behind a dead time drives M x'' + B x' + K x = K g P."""
    rng = np.random.default_rng(number)
    t = np.arange(rows) / RATE
    K, B = stiffness_and_damping(number)
    since = np.maximum(t - AT - DEAD, 0.0)
    rise = 1 - np.exp(-since / LAG)
    # poles of the muscle and of the lag: partial fractions of w^2 / (s (s^2 + 2Dws + w^2) (LAG s + 1))
    w2, d = K / MASS, B / MASS
    pole = -d / 2 + 1j * np.sqrt(w2 - d * d / 4)
    a = 1 / LAG
    lag_part = -w2 / (a * a - d * a + w2)
    swing = w2 * a / (pole * (pole - pole.conjugate()) * (pole + a))
    motion = np.where(since > 0, 1 + lag_part * np.exp(-a * since) + 2 * (swing * np.exp(pole * since)).real, 0.0)
    P = FROM + (TO - FROM) * rise + 100.0 * rng.standard_normal(rows)
    x = STROKE_PER_PRESSURE * (FROM + (TO - FROM) * motion) + 1e-5 * rng.standard_normal(rows)
    return t, {
        "pressure": P,
        "displacement": x,
        "force": 77.0 + 0.2 * rng.standard_normal(rows),
        "pressure_command": np.where(t < AT, FROM, TO),
        "supply": 700e3 + 500.0 * rng.standard_normal(rows),
        "temperature": 21.0 + 0.02 * rng.standard_normal(rows),
    }


def write_run(parent, number, rows=ROWS):
    """One closed run; its folder."""
    t, values = samples(number, rows)
    name = (
        f"2019{number // 500 % 12 + 1:02d}{number // 25 % 20 + 1:02d}-{number % 25:02d}{number:06d}_A{number % 20:03d}"
    )
    manifest = {
        "kind": "recorded-step",
        "started_utc": f"2019-{number // 500 % 12 + 1:02d}-01T08:00:00.000+00:00",
        "specimen": {"type": "MAS-20", "serial": f"A{number % 20:03d}"},
        "imported": {"file": f"{number}.csv", "folder": "old", "findings": [], "flagged": {}, "late_by": {"pressure": LATE}, "analysis": {}},
    }  # fmt: skip
    writer = RunWriter.create(parent, name, manifest, {"map.yaml": b"schema: pmabench.map/1\n"})
    record = CalibrationRecord("C-1", "DPI-104", "2019-01-01", "2020-01-01", 500.0, 0.001, 0.0, "ab" * 32)
    columns = [
        asdict(ChannelRecord(channel, quantity, "file", "", "int32", "count", scale, -1e9, 1e9, "", record))
        for channel, (quantity, scale) in SCALES.items()
    ]
    writer.open_stream("file", columns, RATE)
    raw = {channel: np.round(values[channel] / scale.slope).astype(np.int32) for channel, (_, scale) in SCALES.items()}
    writer.append("file", np.round(t * 1e9).astype(np.int64), raw, np.zeros(rows, np.uint16))
    point = {"from": FROM, "pressure": TO, "mass": MASS}
    writer.event("trial-begin", 0.0, trial=0, point=point, repeat=0, reference=False)
    writer.event("command", AT, trial=0, output="pressure", type="set", value=TO, before=FROM, phase="step")
    writer.event("trial-end", (rows - 1) / RATE, trial=0, status="finished")
    return writer.close("finished")
