"""The proof test of the vent path: fill to a low pressure, vent, look; before anything else is commanded."""

from __future__ import annotations

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
    safe = next(output.safe for output in bench.outputs if output.name == "pressure")
    asked = clock.now()
    guard.set("pressure", proof.pressure)
    acquisition.commanded.set("pressure", asked, proof.pressure)
    filled = acquisition.pass_time(proof.fill, _crossing(above=FILLED * proof.pressure))
    if filled is None:
        measured = show(acquisition.latest.get("pressure", float("nan")), "pressure")
        raise LimitTripped(
            f"the proof test asked for {show(proof.pressure, 'pressure')}, and after {proof.fill:g} s {measured} is "
            "measured: no supply, a shut valve, or the pressure channel is wired wrongly"
        )
    vented_at = clock.now()
    guard.set("pressure", safe)
    acquisition.commanded.set("pressure", vented_at, safe)  # it falls as commanded: no burst
    guard.valves(closed=False)
    vented = acquisition.pass_time(proof.within, _crossing(below=proof.below))
    if vented is None:
        measured = show(acquisition.latest.get("pressure", float("nan")), "pressure")
        raise LimitTripped(
            f"the vent path failed its proof test: {measured} {proof.within:g} s after venting, "
            f"below {show(proof.below, 'pressure')} was expected; look at the dump valve and at the regulator's exhaust"
        )
    guard.valves(closed=True)
    guard.release()
    recorder.event(
        "proof-test", clock.now(), pressure=proof.pressure, filled_in=filled - asked, vented_in=vented - vented_at
    )


def _crossing(above: float = float("-inf"), below: float = float("inf")) -> Stop:
    def crossed(block: Samples) -> int | None:
        values = block.values.get("pressure")
        if values is None:
            return None
        inside = (values > above) & (values < below)
        return int(inside.argmax()) if inside.any() else None

    return crossed
