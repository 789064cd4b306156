"""No generated protocol, valid or hostile, gets a command outside the limits past a recording device (promise S1)."""

import os
from dataclasses import replace

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pmabench.base.errors import PmaError
from pmabench.bench.compile import mount
from pmabench.bench.interface import Block, Identity
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.files.document import Document
from pmabench.kinds.compile import compile_protocol, read_protocol
from tests.engine.benches import ROOT, SPECIMEN

CASES = int(os.environ.get("PMABENCH_CASES", "500"))
PRESSURE = (-1.0, 600e3 * (1 + 1e-6))
"""What may be commanded [Pa]."""
SI_PER_UNIT = {"pressure": 1000e3 / 65535, "displacement": 1e-3}
"""Written out again here: the judge does not use the scales of the bench files."""


class Judge:
    """A device without physics that decodes by itself whatever it is told; its displacement moves at random."""

    reported: list[tuple[str, float]] = []

    def __init__(self, device, clock):
        self.device, self.clock = device, clock
        self.holds = {"pressure": 0.0, "displacement": 0.0}
        self.random = np.random.default_rng(1)
        self.start_at, self.rate, self.count = 0.0, 500.0, 0

    def open(self):
        return Identity("test", "judge", "1", "0", simulated=True)

    def close(self):
        pass

    def start(self, rate):
        self.start_at, self.rate, self.count = self.clock.now(), rate, 0
        return rate

    def collect(self):
        due = int((self.clock.now() - self.start_at) * self.rate + 1e-6) + 1
        index = np.arange(self.count, max(due, self.count))
        self.count = max(due, self.count)
        n = len(index)
        si = {
            "pressure": np.full(n, min(self.holds["pressure"] * SI_PER_UNIT["pressure"], 10e3)),
            "displacement": self.random.uniform(-4e-3, 60e-3, n),
            "force": np.full(n, 100.0),
            "angle": self.random.uniform(-0.1, 1.4, n),
            "pressure_command": np.full(n, self.holds["pressure"] * SI_PER_UNIT["pressure"]),
            "displacement_command": np.full(n, self.holds["displacement"] * SI_PER_UNIT["displacement"]),
        }
        columns = {c.name: c.scale.to_raw(si[c.name]) for c in self.device.channels}
        return Block((self.start_at * 1e9 + index * (1e9 / self.rate)).astype(np.int64), columns)

    def stop(self):
        pass

    def write(self, output, value):
        self.reported.append((output, value * SI_PER_UNIT[output]))
        self.holds[output] = value

    def read_back(self, output):
        return self.holds[output]

    def follow(self, output, segment):
        unit = SI_PER_UNIT[output]
        for value in (segment.origin, segment.origin - segment.amplitude, segment.origin + segment.amplitude):
            self.reported.append((output, value * unit))
        if segment.kind == "ramp":
            self.reported.append((output, segment.target * unit))
        self.holds[output] = segment.target if segment.kind == "ramp" else segment.origin

    def halt(self, output):
        pass

    def place(self, load):
        pass

    def switch(self, output, *, on):
        self.holds[output] = on

    def is_on(self, output):
        return self.holds.get(output, False)


def judged(name, specimen=SPECIMEN):
    made = mount(ROOT / "fixtures" / "benches" / f"{name}.yaml", specimen)
    devices = tuple(replace(d, driver=f"{__name__}:Judge") for d in made.bench.devices)
    return replace(made, bench=replace(made.bench, devices=devices))


BENCHES = {
    "weights": judged("mock"),
    "actuator": judged("mock-actuator"),
    "closed": judged("mock-daerden-closed", SPECIMEN.with_name("daerden-20-200.yaml")),
    "arm": judged("mock-arm", SPECIMEN.with_name("arm-30.yaml")),
}
BENCHES_OF = {
    "static-load": "weights", "contraction-relaxation": "weights", "ultimate-gain": "weights",
    "ultimate-gain-relay": "weights", "positioning-pi": "weights", "validation": "weights", "free-contraction": "weights",
    "sinusoidal-displacement": "actuator", "isobaric-ramp": "actuator", "step-displacement": "actuator",
    "isometric-pressurisation": "actuator", "closed-volume": "closed", "ultimate-gain-open-loop": "weights",
    "arm-angle": "arm", "relaxation": "closed",
}  # fmt: skip
REACH = {"actuator": (0.0, 50e-3), "closed": (-6e-3, 40e-3)}
"""Where the free end may be sent [m]; written out again here, as the pressure."""
MOST = {"arm": 500e3 * (1 + 1e-6)}
"""Where less pressure is allowed than elsewhere [Pa]."""

number = st.one_of(
    st.floats(0, 700).map(lambda v: f"{v:.6g}"),
    st.sampled_from(["0", "-1", "599.99999", "600", "600.0001", "1e3", "1e308", "-0.0", "nan", "inf", ".5", "1,5"]),
)
pressure = st.builds(
    lambda n, u: f"{n} {u}", number, st.sampled_from(["kPa", "kPa", "kPa", "bar", "psi", "Pa", "mm", ""])
)
length = st.builds(
    lambda n, u: f"{n} {u}", st.floats(-5, 70).map(lambda v: f"{v:.4g}"), st.sampled_from(["mm", "mm", "cm", "kPa"])
)
seconds = st.floats(-0.1, 1.0).map(lambda v: f"{v:.3g} s")
SETTINGS = {
    "contraction-relaxation": {
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=3).map(lambda v: f"[{', '.join(v)}]"),
        "trial.relax.by": pressure,
        "trial.relax.then": pressure,
        "prepare.precondition.pressure": pressure,
        "trial.contract.hold": seconds,
    },
    "static-load": {
        "trial.search.up_to": pressure,
        "trial.search.back_off": pressure,
        "trial.search.rate": st.floats(-1, 400).map(lambda v: f"{v:.4g} kPa/s"),
        "trial.search.approach_rate": st.floats(-1, 400).map(lambda v: f"{v:.4g} kPa/s"),
        "trial.search.moved": length,
    },
    "sinusoidal-displacement": {
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=2).map(lambda v: f"[{', '.join(v)}]"),
        "trial.mean": length,
        "trial.amplitude": length,
        "sweep.matrix.frequency": st.floats(-1, 30).map(lambda v: f"[{v:.3g} Hz]"),
    },
    "step-displacement": {
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=2).map(lambda v: f"[{', '.join(v)}]"),
        "sweep.matrix.step": length.map(lambda v: f"[{v}]"),
        "sweep.matrix.speed": st.floats(-1, 700).map(lambda v: f"[{v:.3g} mm/s]"),
        "trial.start": length,
        "trial.hold": seconds,
    },
    "isobaric-ramp": {
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=2).map(lambda v: f"[{', '.join(v)}]"),
        "sweep.matrix.speed": st.floats(-1, 700).map(lambda v: f"[{v:.3g} mm/s]"),
        "trial.lower": length,
        "trial.upper": length,
        "trial.turn": length,
        "trial.approach": st.floats(-1, 700).map(lambda v: f"{v:.3g} mm/s"),
    },
    "ultimate-gain": {
        "sweep.zip.bias": pressure.map(lambda v: f"[{v}]"),
        "trial.pressure": st.tuples(pressure, pressure).map(lambda v: f"[{v[0]}, {v[1]}]"),
        "trial.gain_steps.start": st.floats(-1, 1e4).map(lambda v: f"{v:.4g} kPa/mm"),
        "trial.gain_steps.window": length,
    },
    "ultimate-gain-open-loop": {
        "sweep.zip.bias": pressure.map(lambda v: f"[{v}]"),
        "trial.pressure": st.tuples(pressure, pressure).map(lambda v: f"[{v[0]}, {v[1]}]"),
        "trial.open_loop.amplitude": pressure,
    },
    "ultimate-gain-relay": {
        "sweep.zip.bias": pressure.map(lambda v: f"[{v}]"),
        "trial.pressure": st.tuples(pressure, pressure).map(lambda v: f"[{v[0]}, {v[1]}]"),
        "trial.relay.amplitudes": st.one_of(
            st.tuples(pressure, pressure).map(lambda v: f"[{v[0]}, {v[1]}]"),
            st.floats(-5, 400).map(lambda v: f"[{v:.4g} kPa, {2 * v:.4g} kPa]"),
        ),
        "trial.relay.hysteresis": st.floats(-1, 8).map(lambda v: f"[{v:.3g} mm, {2 * v:.3g} mm]"),
        "trial.relay.window": length,
    },
    "free-contraction": {
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=3).map(lambda v: f"[{', '.join(v)}]"),
        "trial.rate": st.floats(-1, 1e4).map(lambda v: f"{v:.4g} kPa/s"),
        "trial.hold": seconds,
        "trial.approach": st.sampled_from(["from-both-sides", "from-below"]),
        "prepare.precondition.pressure": pressure,
    },
    "arm-angle": {
        "sweep.matrix.load": st.floats(-0.1, 0.7).map(lambda v: f"[{v:.1f} kg]"),
        "trial.preload": pressure,
        "trial.pressures": st.lists(pressure, min_size=1, max_size=3).map(lambda v: f"[{', '.join(v)}]"),
        "trial.rate": st.floats(-1, 1e4).map(lambda v: f"{v:.4g} kPa/s"),
        "trial.radius": length,
        "compare": st.sampled_from(["paper-2", "nothing"]),
        "prepare.precondition.pressure": pressure,
    },
    "isometric-pressurisation": {
        "sweep.matrix.contraction": st.one_of(length, st.floats(-5, 40).map(lambda v: f"{v:.3g} %")).map(
            lambda v: f"[{v}]"
        ),
        "trial.pressurise.start": pressure,
        "trial.pressurise.stop": pressure,
        "trial.pressurise.rate": st.floats(-1, 1e4).map(lambda v: f"{v:.4g} kPa/s"),
        "trial.move.pressure": pressure,
        "trial.move.speed": st.floats(-1, 700).map(lambda v: f"{v:.3g} mm/s"),
    },
    "closed-volume": {
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=2).map(lambda v: f"[{', '.join(v)}]"),
        "trial.start": length,
        "trial.to": length,
        "trial.speed": st.floats(-1, 1500).map(lambda v: f"{v:.3g} mm/s"),
        "trial.settle": seconds,
    },
    "relaxation": {
        "sweep.matrix.contraction": length.map(lambda v: f"[{v}]"),
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=2).map(lambda v: f"[{', '.join(v)}]"),
        "trial.approach": st.floats(-1, 1500).map(lambda v: f"{v:.3g} mm/s"),
        "trial.begin": seconds,
        "trial.rest": st.floats(-1, 60).map(lambda v: f"{v:.3g} s"),
    },
    "positioning-pi": {
        "controller.output": st.tuples(pressure, pressure).map(lambda v: f"[{v[0]}, {v[1]}]"),
        "controller.gains": st.builds(lambda K, T: f"{{K_p: {K:.4g} kPa/mm, T_i: {T}}}", st.floats(-1, 1e12), seconds),
        "sweep.matrix.setpoint": st.lists(length, min_size=1, max_size=2).map(lambda v: f"[{', '.join(v)}]"),
        "controller.anti_windup": st.sampled_from(["back-calculation", "clamping"]),
    },
    "validation": {
        "sweep.matrix.pressure": st.lists(pressure, min_size=1, max_size=2).map(lambda v: f"[{', '.join(v)}]"),
        "trial.hold": seconds,
        "trial.window": st.tuples(seconds, seconds).map(lambda v: f"[{v[0]}, {v[1]}]"),
    },
}
SHORT = {
    "contraction-relaxation": {"sweep.matrix.load": "[6 kg]", "sweep.repeat.count": "1", "prepare.precondition.cycles": "1",
                               "trial.relax.hold": "0.1 s", "trial.relax.hold_at_end": "0.2 s"},
    "static-load": {"sweep.matrix.load": "[6 kg]", "sweep.repeat.count": "1", "prepare.precondition.cycles": "0"},
    "sinusoidal-displacement": {"sweep.repeat.count": "1", "trial.at_least": "0 s", "prepare.precondition.cycles": "0"},
    "step-displacement": {"sweep.matrix.pressure": "[300 kPa]", "sweep.matrix.speed": "[20 mm/s]", "trial.hold": "0.3 s",
                          "prepare.precondition.cycles": "0"},
    "isobaric-ramp": {"sweep.matrix.pressure": "[300 kPa]", "sweep.matrix.speed": "[20 mm/s]", "trial.cycles": "2",
                      "prepare.precondition.cycles": "0"},
    "ultimate-gain": {"sweep.repeat.count": "1", "prepare.precondition.cycles": "0", "trial.gain_steps.levels": "2",
                      "trial.gain_steps.level_time": "0.05 s", "trial.gain_steps.settle": "0.05 s"},
    "ultimate-gain-open-loop": {"prepare.precondition.cycles": "0", "trial.approach": "0.2 s",
                                "trial.open_loop.hold": "0.2 s", "trial.open_loop.settle": "0.05 s"},
    "ultimate-gain-relay": {"sweep.repeat.count": "1", "prepare.precondition.cycles": "0", "trial.approach": "0.2 s",
                            "trial.relay.level_time": "0.5 s", "trial.relay.settle": "0.05 s"},
    "free-contraction": {"sweep.matrix.pressure": "[200 kPa]", "sweep.repeat.count": "1", "prepare.precondition.cycles": "0",
                         "trial.rest": "0.5 s", "trial.hold": "0.5 s"},
    "arm-angle": {"sweep.matrix.load": "[0.2 kg]", "sweep.repeat.count": "1", "prepare.precondition.cycles": "0",
                  "trial.pressures": "[100 kPa, 300 kPa]", "trial.hold": "0.5 s"},
    "isometric-pressurisation": {"sweep.matrix.contraction": "[4 %]", "sweep.repeat.count": "1",
                                 "prepare.precondition.cycles": "0", "trial.settle": "0.1 s"},
    "closed-volume": {"sweep.matrix.pressure": "[300 kPa]", "sweep.repeat.count": "1", "prepare.precondition.cycles": "0",
                      "trial.cycles": "1", "trial.rest": "0.1 s", "trial.settle": "0.1 s"},
    "relaxation": {"sweep.matrix.pressure": "[300 kPa]", "sweep.matrix.contraction": "[10 mm]",
                   "prepare.precondition.cycles": "0", "trial.hold": "10 s", "trial.rest": "10 s"},
    "positioning-pi": {"prepare.precondition.cycles": "0", "trial.hold": "0.2 s", "trial.window": "[0.1 s, 0.2 s]",
                       "sweep.matrix.setpoint": "[30 mm]"},
    "validation": {"prepare.precondition.cycles": "0", "trial.hold": "0.2 s", "trial.window": "[0.1 s, 0.2 s]"},
}  # fmt: skip


@st.composite
def protocols(draw):
    kind = draw(st.sampled_from(sorted(SETTINGS)))
    chosen = draw(st.lists(st.sampled_from(sorted(SETTINGS[kind])), max_size=3, unique=True))
    return kind, [*SHORT[kind].items(), *((name, draw(SETTINGS[kind][name])) for name in chosen)]


LONGEST = 300.0
"""Plans that could take longer [s of bench time] are judged by their envelope only."""

TALLY = {"tried": 0, "run": 0, "refused": 0}


@settings(max_examples=CASES, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(protocols())
def test_nothing_outside_the_limits_reaches_the_device(protocol):
    kind, changes = protocol
    TALLY["tried"] += 1
    Judge.reported.clear()
    mounted = BENCHES[BENCHES_OF[kind]]
    try:
        document, model = read_protocol(ROOT / "protocols" / f"{kind}.yaml", changes)
        plan = compile_protocol(document, model, mounted)
    except PmaError as error:
        TALLY["refused"] += 1
        assert "--set" in str(error) or ".yaml:" in str(error), "refused without a place"
        assert not Judge.reported
        return
    least, most = (end + slip for end, slip in zip(REACH.get(BENCHES_OF[kind], (0, 0)), (-1e-8, 1e-8), strict=True))
    allowed = {"pressure": (PRESSURE[0], MOST.get(BENCHES_OF[kind], PRESSURE[1])), "displacement": (least, most)}
    for output, (low, high) in plan.commands().items():
        assert allowed[output][0] <= low <= high <= allowed[output][1]
    if plan.duration()[1] > LONGEST:
        return
    TALLY["run"] += 1
    outcome = run_plan(plan, mounted, ConfirmedBeforehand(), out=None)
    assert outcome.exit_code in {0, 5, 6}, outcome.why
    for output, value in Judge.reported:
        assert allowed[output][0] <= value <= allowed[output][1], f"{output} was commanded to {value}"
    assert ("pressure", 0.0) in Judge.reported[-3:], "did not vent"


def test_the_generator_makes_both_kinds(record_property):
    record_property("cases", TALLY["tried"])
    assert TALLY["tried"] >= CASES
    assert TALLY["run"] > CASES // 20
    assert TALLY["refused"] > CASES // 10


def test_the_judge_would_notice():
    document = Document("x", "a: 1")
    assert document.data == {"a": 1}
    judge = Judge(BENCHES["weights"].bench.devices[0], None)
    judge.write("pressure", 65535.0)
    output, value = Judge.reported[-1]
    assert output == "pressure"
    assert not PRESSURE[0] <= value <= PRESSURE[1]
