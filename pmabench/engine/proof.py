"""The proof test of the vent path: fill to a low pressure, vent, look; before anything else is commanded."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.base.errors import LimitTripped
from pmabench.base.quantities import show
from pmabench.bench.interface import CompiledBench
from pmabench.engine.acquire import Acquisition, Samples, Stop
from pmabench.engine.commanded import Commands
from pmabench.engine.recorder import Recorder

FILLED = 0.8
"""Of the asked pressure, from where on the bench counts as filled."""


def prove(bench: CompiledBench, guard: Commands, acquisition: Acquisition, recorder: Recorder) -> None:
    """Try the vent path of a bench that declares a proof test; raises LimitTripped where it does not vent in time."""
    proof = bench.proof
    if proof is None:
        return
    clock = acquisition.clock
    names = [output.name for output in bench.pressures]
    asked = clock.now()
    for name in names:
        guard.set(name, proof.pressure)
        acquisition.commanded.set(name, asked, proof.pressure)
    filled = acquisition.pass_time(proof.fill, _crossing(names, above=FILLED * proof.pressure))
    if filled is None:
        measured = _measured(acquisition, names)
        raise LimitTripped(
            f"the proof test asked for {show(proof.pressure, 'pressure')}, and after {proof.fill:g} s {measured} is "
            "measured: no supply, a shut valve, or the pressure channel is wired wrongly"
        )
    vented_at = clock.now()
    for output in bench.pressures:
        guard.set(output.name, output.safe)
        acquisition.commanded.set(output.name, vented_at, output.safe)  # it falls as commanded: no burst
    guard.valves(closed=False)
    vented = acquisition.pass_time(proof.within, _crossing(names, below=proof.below))
    if vented is None:
        measured = _measured(acquisition, names)
        raise LimitTripped(
            f"the vent path failed its proof test: {measured} {proof.within:g} s after venting, "
            f"below {show(proof.below, 'pressure')} was expected; look at the dump valve and at the regulator's exhaust"
        )
    guard.valves(closed=True)
    guard.release()
    recorder.event(
        "proof-test", clock.now(), pressure=proof.pressure, filled_in=filled - asked, vented_in=vented - vented_at
    )


def _measured(acquisition: Acquisition, names: Sequence[str]) -> str:
    """The newest pressure of each muscle, in words."""
    return " and ".join(show(acquisition.latest.get(name, float("nan")), "pressure") for name in names)


def _crossing(names: Sequence[str], above: float = float("-inf"), below: float = float("inf")) -> Stop:
    """The sample at which the last of these channels has come between the bounds."""
    left = set(names)

    def crossed(block: Samples) -> int | None:
        last = None
        for name in left & block.values.keys():
            inside = (block.values[name] > above) & (block.values[name] < below)
            if inside.any():
                left.discard(name)
                last = max(last or 0, int(inside.argmax()))
        return last if not left else None

    return crossed
