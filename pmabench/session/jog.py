"""Pressure and actuator by hand, in steps, inside the bench's set-up pressure: a run of kind `setup`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import OutputRecord
from pmabench.engine.executor import Executor
from pmabench.engine.operator import Operator
from pmabench.engine.run import Outcome, run_plan
from pmabench.protocol.plan import Ramp, Set
from pmabench.session.guided import guided_plan
from pmabench.session.listening import Series, listen

PHASE = "jog"
BLOCK = 0.1
"""How long is listened between two looks at the keys [s]."""
TRAVEL = 0.05
"""Speed of the actuator, of its highest."""
STEPS = {"pressure": (1e3, 2e3, 5e3, 10e3, 20e3, 50e3), "displacement": (0.1e-3, 0.2e-3, 0.5e-3, 1e-3, 2e-3, 5e-3)}
"""Steps that can be chosen [SI]."""
KEYS = "+ - pressure   ] [ actuator   > < step   0 no pressure   z tare   v vent and end"


@dataclass
class Jog:
    """Where the outputs stand [SI], and by how much a key moves them."""

    executor: Executor
    mounted: Mounted
    stands: dict[str, float] = field(default_factory=dict)
    size: int = 2
    """Index of the step in `STEPS`."""
    over: bool = False

    def __post_init__(self) -> None:
        self._outputs = {output.name: output for output in self.executor.bench.outputs}
        self.stands = {name: output.safe for name, output in self._outputs.items()}

    def press(self, key: str) -> str:
        """Do what a key says; what was done, in words, empty for a key that means nothing."""
        if key in "+-" and "pressure" in self._outputs:
            return self._step("pressure", 1 if key == "+" else -1)
        if key in "][" and "displacement" in self._outputs:
            return self._step("displacement", 1 if key == "]" else -1)
        if key in "><":
            self.size = min(max(self.size + (1 if key == ">" else -1), 0), len(STEPS["pressure"]) - 1)
            return f"step {self.steps()}"
        if key == "0" and "pressure" in self._outputs:
            return self._go("pressure", self._outputs["pressure"].safe)
        if key.lower() in "vq":
            self.over = True
            return "vent and end"
        return ""

    def steps(self) -> str:
        """The step of each output, in words."""
        sizes = ((name, STEPS[name][self.size]) for name in self._outputs if name in STEPS)
        return ", ".join(show(size, self._outputs[name].quantity) for name, size in sizes)

    def settings(self) -> str:
        """What is commanded, in words."""
        told = []
        for name, value in self.stands.items():
            output = self._outputs[name]
            most = show(self._most(output), output.quantity, 4)
            told.append(f"{name} {show(value, output.quantity, 4)} (up to {most})")
        return "commanded " + "   ".join(told)

    def _most(self, output: OutputRecord) -> float:
        return min(output.high, self.executor.bench.setup_pressure) if output.name == "pressure" else output.high

    def _step(self, name: str, way: int) -> str:
        output = self._outputs[name]
        wanted = self.stands[name] + way * STEPS[name][self.size]
        value = min(max(wanted, output.low), self._most(output))
        told = self._go(name, value)
        return told if value == wanted else f"{told}: its limit here"

    def _go(self, name: str, value: float) -> str:
        output = self._outputs[name]
        before = self.stands[name]
        if value != before:
            if output.rate:
                self.executor.do(Ramp(PHASE, name, before, value, TRAVEL * output.rate))
            else:
                self.executor.do(Set(PHASE, name, value))
            self.stands[name] = value
        return f"{name} {show(value, output.quantity, 4)}"


def jog(
    mounted: Mounted,
    operator: Operator,
    out: Path | None,
    keys: Callable[[], Sequence[str]],
    shown: Callable[[Mapping[str, Series], Jog, Sequence[str]], None],
    *,
    operator_name: str = "",
) -> Outcome:
    """Move the bench by keys until `v` or `q`. `shown` gets the newest samples and what keys did.

    Neither `keys` nor `shown` may wait. Raises UsageError where the bench has nothing to move.
    """
    if not mounted.bench.outputs:
        raise UsageError(f'"{mounted.bench.name}" has no output to move; look at it without --jog')

    def procedure(executor: Executor) -> None:
        work = Jog(executor, mounted)
        executor.acquisition.record(on=True)
        while not work.over:
            series = listen(executor.acquisition, BLOCK)
            told = []
            for key in keys():
                told.append(work.press(key))
                if key == "z":
                    executor.recorder.event("tare", executor.clock.now())
            shown(series, work, [line for line in told if line])

    plan = guided_plan(mounted, "setup", f"set-up of {mounted.bench.name}")
    return run_plan(plan, mounted, operator, out=out, operator_name=operator_name, procedure=procedure)
