"""Laws of seeks by name: what ships with pmabench, and entry points of the group `pmabench.laws`.

A class is a small state machine that is fed one sample at a time: `pmabench.engine.seek.SampledLaw` for one output,
`pmabench.engine.laws.orders.LawOfSeveral` for several quantities and valves. A function ramps and waits by the
`pmabench.engine.moves.Moves` that it is handed. What they need comes as keywords from the plan's step.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.extensions import registered

GROUP = "pmabench.laws"
LAWS = {
    "p": "proportional:Proportional",
    "gain-steps": "gain_steps:GainSteps",
    "relay": "relay:Relay",
    "pid": "position_loop:PositionLoop",
    "ramp-until": "ramp_until:ramp_until",
    "closed-strokes": "closed_strokes:closed_strokes",
    "platform": "platform_loop:PlatformLoop",
    "joint": "joint_loop:JointLoop",
}
"""Name of a law in a plan -> its module here, and its class or function."""


def law_of(name: str) -> Any:
    """The class or function of a law; UsageError where no installed package has one of this name."""
    if name in LAWS:
        module, _, attribute = LAWS[name].partition(":")
        return getattr(import_module(f"{__name__}.{module}"), attribute)
    brought = {point.name: point for point in registered(GROUP)}
    if name not in brought:
        known = (*LAWS, *brought)
        raise UsageError(f'no installed package has a law "{name}"{did_you_mean(name, known)}')
    return brought[name].load()
