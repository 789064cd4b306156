"""Runs of a muscle that is a closed form: K x_inf = F_ce - F_L, approached as an exponential; written as an engine does."""

import json
from dataclasses import asdict

import numpy as np

from pmabench.bench.interface import ChannelRecord, Scale
from pmabench.store.records import Flag
from pmabench.store.writer import RunWriter

RATE = 500.0
HOLD = 4.0
BASELINE = 0.2
TAU = 0.25
DEAD = 0.04
COLUMNS = [
    asdict(ChannelRecord("pressure", "pressure", "daq", "0", "float64", "Pa", Scale(), -1e5, 1e6)),
    asdict(ChannelRecord("displacement", "length", "daq", "1", "float64", "m", Scale(), -0.01, 0.09)),
    asdict(ChannelRecord("force", "force", "daq", "2", "float64", "N", Scale(), -100.0, 2000.0)),
]
SPECIMEN = """schema: pmabench.specimen/1
make: Festo
type: MAS-20
serial: TEST-1
nominal_length: 250 mm
inner_diameter: 20 mm
mounted: {date: 2026-11-21, length: 250 mm, at: {load: 6 kg, pressure: 0 kPa}}
limits: {pressure: {command: 600 kPa, never_above: 700 kPa}, contraction: 28 %, source: assumed}
expected:
  source: closed form
  points:
    - {pressure: 100 kPa, F_ce: 60 N, K: 6 N/mm, B_c: 1.5 N.s/mm, B_r: 1.5 N.s/mm}
    - {pressure: 500 kPa, F_ce: 500 N, K: 8 N/mm, B_c: 2 N.s/mm, B_r: 2 N.s/mm}
"""
TRIPS = [
    {"channel": "pressure", "low": -30e3, "high": 650e3, "delay": 0.004, "action": "vent"},
    {"channel": "displacement", "low": None, "high": 0.07, "delay": 0.0, "action": "vent"},
    {"channel": "force", "low": None, "high": 1900.0, "delay": 0.0, "action": "vent"},
]
BENCH = {
    "name": "rig",
    "realtime": False,
    "devices": [
        {
            "name": "daq",
            "channels": COLUMNS,
            "outputs": [{"name": "pressure", "quantity": "pressure", "low": 0.0, "high": 600e3}],
        }
    ],
    "trips": TRIPS,
}


def F_ce(P):
    """The specimen's own line [N] over pressure [Pa]."""
    return 60.0 + (P - 1e5) * 440.0 / 4e5


def K(P):
    """[N/m]."""
    return 6000.0 + (P - 1e5) * 2000.0 / 4e5


def plan(points):
    """A plan of contraction trials at (load, pressure)."""
    steps = [{"step": "ask", "phase": "load", "text": "Put 6 kg on.", "demands": "vented", "load": [58.86, 8.0]}]
    for number, (_, pressure) in enumerate(points):
        steps += [
            {"step": "record", "phase": "rest", "on": True, "trial": number},
            {"step": "hold", "phase": "rest", "duration": BASELINE},
            {"step": "set", "phase": "contract", "output": "pressure", "value": pressure},
            {"step": "hold", "phase": "contract", "duration": HOLD},
            {"step": "set", "phase": "vent", "output": "pressure", "value": 0.0},
            {"step": "hold", "phase": "vent", "duration": 1.0},
            {"step": "record", "phase": "vent", "on": False, "trial": number},
        ]
    trials = [{"index": i, "point": {"load": f, "mass": 8.0, "pressure": p}} for i, (f, p) in enumerate(points)]
    record = ["pressure", "displacement", "force"]
    return {"schema": "pmabench.plan/1", "trials": trials, "steps": steps, "record": record, "settings": {}}


LENGTH = BASELINE + HOLD + 1.0


class Recorded:
    """A run that is written trial by trial."""

    def __init__(self, parent, points, name="run", **manifest):
        self.points = points
        reported = {
            "kind": "contraction-relaxation",
            "simulated": True,
            "specimen": {"type": "MAS-20", "serial": "TEST-1"},
            "bench": "rig",
        }
        snapshots = {
            "plan.json": json.dumps(plan(points)).encode(),
            "bench.json": json.dumps(BENCH).encode(),
            "specimen.yaml": SPECIMEN.encode(),
        }
        self.writer = RunWriter.create(parent, name, reported | manifest, snapshots)
        self.writer.open_stream("daq", COLUMNS, RATE)
        self.t = 0.0
        self.rows = 0
        self.writer.event("armed", 0.0, bench="rig")

    @property
    def folder(self):
        return self.writer.folder

    def load(self):
        """The operator puts the weight on."""
        self.writer.event("prompt", self.t, text="Put 6 kg on.", phase="load", demands="vented")
        self.writer.event("answer", self.t, text="Put 6 kg on.", answer="clear", pressure=0.0)
        self.writer.event("load", self.t, force=58.86, mass=8.0)
        self.t += 3.0

    def begin(self, index, repeat=0):
        """A trial begins."""
        load, pressure = self.points[index]
        point = {"load": load, "mass": 8.0, "pressure": pressure}
        self.writer.event("trial-begin", self.t, trial=index, point=point, repeat=repeat, reference=False)

    def contract(self, index, until=HOLD, **change):
        """The pressure goes up; samples until so long after it."""
        command = {"output": "pressure", "type": "set", "phase": "contract", "trial": index}
        self.writer.event("command", self.t + BASELINE, value=self.points[index][1], before=0.0, **command)
        self.samples(index, BASELINE + until, **change)

    def samples(self, index, until, factor=1.0, reached=1.0, drift=0.0, flags=0):
        """Samples of a trial up to so long after its beginning."""
        load, pressure = self.points[index]
        first = round(self.t * RATE)
        n = np.arange(max(first, self.rows), round((self.t + until) * RATE))
        t = n / RATE - self.t
        since = np.clip(t - BASELINE - DEAD, 0.0, None)
        end = factor * (F_ce(pressure) - load) / K(pressure)
        x = end * (1 - np.exp(-since / TAU)) + drift * since
        x[t >= BASELINE + HOLD] = 0.0
        P = np.where((t >= BASELINE) & (t < BASELINE + HOLD), pressure * reached, 0.0)
        raw = {"pressure": P, "displacement": x, "force": np.full(len(n), load)}
        flagged = np.where(n == first + 10, flags, int(Flag.OK)).astype(np.uint16)
        self.rows = int(n[-1]) + 1
        self.writer.append("daq", n * int(1e9 / RATE), raw, flagged)
        self.flush()

    def end(self, index, status="finished", **change):
        """The trial vents and ends."""
        at = self.t + BASELINE + HOLD
        command = {"output": "pressure", "type": "set", "phase": "vent", "trial": index}
        self.writer.event("command", at, value=0.0, before=self.points[index][1], **command)
        self.samples(index, LENGTH, **change)
        self.t += LENGTH
        self.writer.event("trial-end", self.t - 1 / RATE, trial=index, status=status)

    def trial(self, index, repeat=0, status="finished", **change):
        """A whole trial."""
        self.begin(index, repeat)
        self.contract(index, **change)
        self.end(index, status, **change)

    def flush(self):
        """What was handed over is on disk now."""
        for stream in self.writer._streams.values():
            stream.drain()

    def close(self, status="finished", why="", vent="confirmed"):
        """Vent and seal."""
        self.writer.event("vent", self.t, result=vent, actions=[])
        return self.writer.close(status, why, vent={"result": vent, "actions": []})
