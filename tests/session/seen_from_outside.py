"""A bench of plain formulas behind a bench file that may be wrong: no device, no emulator, no driver.

Which quantity is at which terminal, with which scale, is the right file's; what is made of it, and where commands go, is
the wrong one's. `SelfTesting` does here what it does on an armed bench.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from pmabench.engine.acquire import Samples, Tripped
from pmabench.protocol.plan import HANDS_OUT
from pmabench.session.checks import SelfTestFailed
from pmabench.session.self_test import SelfTesting

RATE, G = 200.0, 9.81
DEAD, LAG, DUMP_LAG = 0.04, 0.0955, 0.05
"""Of the regulator and of the dump valve [s]."""
NOISE = {"pressure": 500.0, "force": 0.3, "displacement": 2e-6}


@dataclass
class Outside:
    """A right bench as it is: residual rest position, errors of zeros and gains within their limits."""

    rest: float = 0.0
    """Where the free end rests without pressure [m]."""
    load: float = 0.0
    """What hangs on it before anybody asks [N]."""
    strength: float = 1.0
    hung: float = 1.0
    """Share of the load that was asked for which hands really put on."""
    exhaust: float = LAG
    """Lag of the regulator when it vents [s]."""
    zeros: dict = field(default_factory=dict)
    gains: dict = field(default_factory=dict)
    seed: int = 0


class Bench:
    """The executor, its guard and its acquisition, as far as a self-test knows them."""

    def __init__(self, right, wrong, outside):
        self.right, self.wrong, self.outside = right.bench, wrong.bench, outside
        self.bench, self.unloaded, self.rng = wrong.bench, False, np.random.default_rng(outside.seed)
        self.t, self.place, self.load, self.x = 0.0, 0.0, outside.load, 0.0 if outside.load > 20.0 else outside.rest
        self.target, self.since, self.origin, self.lag = 0.0, 0.0, 0.0, LAG
        self.set_point, self.energised, self.highest = 0.0, {}, 0.0
        self.driven = right.bench.free_end == "actuator"
        self.clock = SimpleNamespace(now=lambda: self.t)
        self.event = lambda *_args, **_data: None
        self.guard = self
        self.acquisition = self
        self.rate, self.latest = RATE, {}
        self.valves(closed=True)

    # -- what the program does --------------------------------------------------------------------------------------

    def do(self, step):
        getattr(self, f"_{step.kind.replace('-', '_')}")(step)

    def _set(self, step):
        self._send(step.output, step.value)

    def _ramp(self, step):
        self._send(step.output, step.to)
        self.pass_time(step.longest())

    def _hold(self, step):
        self.pass_time(step.duration)

    def _ask(self, step):
        self._send("pressure", 0.0)
        self.pass_time(1.0)
        self.load = self.outside.hung * step.load[0]
        self.x = self._resting()
        self.pass_time(HANDS_OUT)

    def _send(self, name, value):
        """By the wrong file's scale to its terminal; whatever the right file has there gets it."""
        output = next(o for o in self.wrong.outputs if o.name == name)
        raw = output.scale.to_raw(value)
        for there in self.right.outputs:
            if (there.device, there.output) == (output.device, output.output):
                if there.name == "pressure":
                    self.set_point = min(max(there.scale.to_si(raw), 0.0), 1e6)
                    self._regulate()
                else:
                    self.place = there.scale.to_si(raw)

    def valves(self, *, closed, only=""):
        for valve in self.wrong.valves:
            if only in ("", valve.name):
                position = "closed" if closed == (valve.safe == "open") else "open"
                self.energised[valve.device, valve.output] = position == valve.energised
        self._regulate()

    def _open(self):
        return any(
            self.energised.get((valve.device, valve.output), False) != (valve.energised == "closed")
            for valve in self.right.valves
        )

    def _regulate(self):
        falls = self.set_point < self._pressure(np.array([self.t]))[0]
        lag = DUMP_LAG if self._open() else self.outside.exhaust if falls else LAG
        target = 0.0 if self._open() else self.set_point
        if (target, lag) != (self.target, self.lag):
            self.origin = float(self._pressure(np.array([self.t]))[0])
            self.since, self.target, self.lag = self.t, target, lag

    # -- what there is ------------------------------------------------------------------------------------------------

    def _pressure(self, t):
        gone = np.maximum(t - self.since - DEAD, 0.0) / self.lag
        return self.target + (self.origin - self.target) * np.exp(-gone)

    def _resting(self):
        """Friction keeps a free end up to 5 mm short, which a load pulls out."""
        return 0.0 if self.load > 20.0 else self.outside.rest

    def _muscle(self, P):
        """Contraction [m] and force at the cell [N] along a course of pressures; quasi-static, with dry friction."""
        pull = self.outside.strength * np.maximum(0.0, 1.08e-3 * P - 49.0)
        K, breaks, slides = 5.8e3, 10.0, 6.0
        if self.driven:
            return np.full(P.shape, self.place), np.maximum(0.0, pull - K * self.place)
        x, F = np.empty(P.shape), np.empty(P.shape)
        for i, f in enumerate(pull):
            drive = f - K * self.x - self.load
            if drive > breaks:
                self.x = (f - self.load - slides) / K
            elif drive < -breaks:
                self.x = max((f - self.load + slides) / K, self._resting())
            x[i] = self.x
            F[i] = self.load if self.x > self._resting() else min(f, self.load)
        return x, F

    def pass_time(self, seconds, keep=lambda _block: None):
        t = self.t + np.arange(1, max(2, round(seconds * RATE)) + 1) / RATE
        P = self._pressure(t)
        x, F = self._muscle(P)
        there = {"pressure": P, "force": F, "displacement": x, "displacement_command": np.full(t.shape, self.place)}
        there |= {"pressure_command": np.full(t.shape, self.set_point)}
        if self.t > self.ends[0]:
            raise self.ends[1]
        values = {}
        inputs = {(c.device, c.input): c for c in self.right.channels}
        for channel in self.wrong.channels:
            source = inputs.get((channel.device, channel.input))
            if source is None:
                continue
            name = source.name
            si = there[name] + NOISE.get(name, 0.0) * self.rng.standard_normal(t.shape)
            si = si * self.outside.gains.get(name, 1.0) + self.outside.zeros.get(name, 0.0)
            raw = source.scale.to_raw(si)
            values[channel.name] = channel.scale.to_si(np.rint(raw) if source.raw_type == "int32" else raw)
        self.t = float(t[-1])
        last = keep(Samples(t, values))
        if last is not None:
            values = {name: column[: last + 1] for name, column in values.items()}
            t, P = t[: last + 1], P[: last + 1]
        self.t = float(t[-1])
        self.highest = max(self.highest, float(P.max()))
        self.latest = {name: float(column[-1]) for name, column in values.items()}


def self_tested(right, wrong, outside, ends=(np.inf, None)):
    """What the self-test of the bench file `wrong` says at a bench that is as `right` says: checks, failure or "", bench.

    `ends`: when [s] which trip ends it.
    """
    bench = Bench(right, wrong, outside)
    bench.ends = ends
    test = SelfTesting(wrong, lambda _checks: None)
    try:
        test.before_proof(bench)
        test.run(bench)
    except (SelfTestFailed, Tripped) as failure:
        return test.checks, str(failure), bench
    return test.checks, "", bench
