"""The kinds of fault: what is done to the regulator, on which protocol, how soon it must be noticed, what is said."""

from __future__ import annotations

from dataclasses import dataclass

ALL = ("holds", "steps", "ramps")
WATCHDOG = 0.5
"""Watchdog of the bench [s]."""


@dataclass(frozen=True)
class Kind:
    """One kind of fault."""

    name: str
    reason: str
    """Words (a regular expression) of which the run's reason names one."""
    noticed: float = 2.0
    """From the cause to the first command of the safe state, or to the end of the device's own watchdog [s]."""
    protocols: tuple[str, ...] = ALL
    value: float = 0.0
    then_ended: bool = False
    """Whether the run is ended by SIGTERM soon after: the fault shows in its vent only."""
    survivable: bool = False
    """Whether the run may go on, if it still has the bench in its hand."""
    cause: str = "fault"
    """From what the time counts: the `fault`, or the first write that was `ignored`."""
    latches: bool = False
    """Whether the bench must be refused afterwards until somebody has reset it: an action of the vent failed (S7)."""
    watched: bool = False
    """Whether it can be seen in the measured pressure only: the bench then watches for it."""
    each: int = 10
    """Random instants in the whole campaign."""


KINDS = (
    # S11: the state of the device
    Kind("restart", "restart|watchdog|set.?point|uptime|valve|connection", 1.0, each=50),
    Kind("restart-valve-kept", "restart|watchdog|set.?point|uptime|valve", 1.0, each=50),
    Kind("watchdog-off", "watchdog", 1.0, each=50),
    Kind("watchdog-time", "watchdog", 1.0),
    Kind("watchdog-ends", "watchdog|set.?point|valve", 1.0),
    # a step or ramp that follows commands the output anew, maybe before the device is asked again (every 0.5 s, S11)
    Kind("set-point", "set.?point|pressure", 1.0, ("holds",), value=4321, each=50),
    Kind("set-point-zero", "set.?point|pressure", 1.0, ("holds",)),
    Kind("dump-valve", "valve", 1.0),
    Kind("serial", "serial|another device|connection", 1.0),
    # S13: writes without effect
    Kind("ignore-set-points", "pressure|set.?point|dump_valve", 1.0, ("steps", "ramps"), cause="ignored", each=20),
    Kind("ignore-all", "pressure|set.?point", 1.0, ("steps", "ramps"), cause="ignored", each=20),
    Kind("ignore-all", "SIGTERM|terminat|operat", 1.0, ("holds",), then_ended=True, cause="ignored", each=20),
    Kind("ignore-valve", "SIGTERM|terminat|operat", 1.0, then_ended=True, latches=True),
    Kind("echo", "pressure", 1.0, ("steps", "ramps"), cause="ignored", each=20, watched=True),
    Kind("echo", "SIGTERM|terminat|operat", 1.0, ("holds",), then_ended=True, cause="ignored", each=20, watched=True),
    # S2, S3: what is measured
    Kind("nan", "pressure", 1.0),
    Kind("ffff", "pressure", 1.0),
    Kind("negative", "pressure", 1.0),
    Kind("frozen", "pressure", 2.0, watched=True),
    Kind("offset", "pressure", 2.0, value=400.0, watched=True),
    Kind("stuck", "pressure", 4.0, ("steps", "ramps"), watched=True),
    Kind("supply", "pressure", 2.0, watched=True),
    Kind("runaway", "pressure|displacement", 2.0, watched=True),
    Kind("e-stop", "e-stop", 1.0),
    # S4, S6: the wire
    Kind("silence", "regulator|pressure", 1.5),
    Kind("slow", "regulator|pressure", 1.5, value=0.3),
    Kind("drip", "regulator|pressure", 1.5),
    Kind("truncated", "regulator|pressure", 1.5),
    Kind("stale", "regulator|pressure", 2.0, watched=True),
    Kind("wrong-transaction", "regulator|pressure", 1.5),
    Kind("wrong-unit", "regulator|pressure", 1.5),
    Kind("exception", "regulator|pressure", 1.0),
    Kind("busy", "regulator|pressure", 1.0),
    Kind("refuse-connections", "regulator|pressure", 1.5),
    Kind("duplicate", "regulator|pressure", 1.5, survivable=True),
    Kind("reset", "regulator|pressure", 1.5, survivable=True),
    Kind("half-open", "regulator|pressure", 1.5, survivable=True),
)
