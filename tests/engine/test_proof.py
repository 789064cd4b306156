"""The proof of the vent path on a bench whose plant is written here: what is wrong is found, what is right goes on (S16)."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pmabench.base.errors import LimitTripped
from pmabench.bench.compile import mount
from pmabench.bench.interface import ProofTest
from pmabench.engine.bench_checks import prove

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
PERIOD = 0.005


class Rig:
    """A muscle behind a regulator and a dump valve, as guard, acquisition, clock and recorder in one; lags of 60 ms."""

    def __init__(self, gives=1.0, reads=1.0, absolute=0.0, connected=True, wide=1.0, exhausts=True, shuts=True):
        self.gives, self.reads, self.absolute = gives, reads, absolute
        self.connected, self.wide, self.exhausts = connected, wide, exhausts
        self.t = self.target = self.P = 0.0
        self.open = not shuts
        self.clock, self.commanded, self.latest, self.events = SimpleNamespace(now=lambda: self.t), self, {}, []

    def set(self, _name, *values):
        if len(values) == 1:  # as the guard; the engine's note of what was commanded has a time, too
            self.target = values[0]

    def valves(self, *, closed):
        self.open = self.connected and not closed

    def release(self):
        return None

    def event(self, kind, _t, **data):
        self.events.append((kind, data))

    def pass_time(self, duration, stop):
        end = self.t + duration
        while self.t < end:
            t, P = self.t + PERIOD * np.arange(1, 11), np.empty(10)
            for i in range(10):
                aim = self.gives * self.target
                flow = (aim - self.P) if aim > self.P or self.exhausts else 0.0
                self.P += PERIOD / 0.06 * (flow - (self.wide * self.P if self.open else 0.0))
                P[i] = self.reads * self.P + self.absolute
            self.t, self.latest = float(t[-1]), {"pressure": float(P[-1])}
            at = stop(SimpleNamespace(t=t, values={"pressure": P}))
            if at is not None:
                return float(t[at])
        return None


@pytest.fixture(scope="module")
def bench():
    mounted = mount(FIXTURES / "benches" / "mock-realtime.yaml", FIXTURES / "specimens" / "mas-20-250-paper0.yaml")
    assert [valve.safe for valve in mounted.bench.valves] == ["open"]
    return replace(mounted.bench, proof=ProofTest(50e3, 20e3, 2.0))


@pytest.mark.parametrize(
    "rig", [Rig(), Rig(gives=1.1), Rig(reads=0.93), Rig(wide=0.3)], ids=["good", "high", "low", "narrow"]
)
def test_a_good_bench_passes_and_the_record_has_both_ways_out(bench, rig):
    prove(bench, rig, rig, rig)
    ((kind, found),) = rig.events
    assert kind == "proof-test"
    assert 0 < found["dump_valve_in"] < 1.0
    assert 0 < found["vented_in"] < 2.0


WRONG = {
    "regulator of another range": (Rig(gives=1.5), "75 kPa is measured"),
    "gauge of another range": (Rig(reads=1.5), "75 kPa is measured"),
    "absolute gauge": (Rig(absolute=101.3e3), "the gauge reads absolute pressure"),
    "valve that is not connected": (Rig(connected=False), "the proof test of dump_valve failed"),
    "neither way": (Rig(connected=False, exhausts=False), "the proof test of dump_valve failed"),
    "no supply": (Rig(gives=0.0), "no supply"),
    "a dump valve that stays open": (Rig(wide=9.0, shuts=False), r"a dump valve that stays open \(.*energised"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_found_before_the_first_trial(bench, name):
    rig, said = WRONG[name]
    with pytest.raises(LimitTripped, match=said):
        prove(bench, rig, rig, rig)
    assert not rig.events


def test_a_regulator_without_exhaust_is_vented_by_the_valve(bench):
    rig = Rig(exhausts=False)
    prove(bench, rig, rig, rig)
    assert rig.P < 20e3
