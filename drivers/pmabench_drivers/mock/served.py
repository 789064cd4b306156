"""Requests to the plant's own process: their execution, device watchdog, log; uses no socket."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import DeviceRecord, Identity, Load, Segment
from pmabench_drivers.mock import MockBench
from pmabench_drivers.mock import options as o
from pmabench_drivers.shared.options import options_of

EMPTY = 1e3
"""Gauge pressure below which the muscle counts as empty [Pa]."""
WATCHDOG = (0.05, 60.0)
"""Shortest and longest time of the watchdog [s]; in steps of 10 ms."""


@dataclass
class Asker:
    """A connection: its number, role (`client`, `rescue`, `control`), process, and the client's bench time 0 [s]."""

    number: int
    role: str = ""
    pid: int = 0
    zero: float = 0.0


class Log:
    """Log of the commands: one JSON object per line, passed to the system when the call returns."""

    def __init__(self, path: str) -> None:
        try:
            self._file = Path(path).open("ab", buffering=0) if path else None  # noqa: SIM115  (closed by `close`)
        except OSError as error:
            raise DeviceError("mock", f"cannot write its log {path}: {error.strerror}") from error

    def write(self, do: str, **data: Any) -> None:
        """Write a line with the moment `t` [s, CLOCK_MONOTONIC]."""
        if self._file is not None and not self._file.closed:
            self._file.write(json.dumps({"t": time.monotonic(), "do": do, **data}).encode() + b"\n")

    def close(self) -> None:
        """Close the file; may be called again."""
        if self._file is not None:
            self._file.close()


class _Bench(MockBench):
    """The mock at the moment of the present request; the server applies the faults of its link."""

    moment = 0.0
    read_options = staticmethod(o.read_realtime)

    def _now(self) -> float:
        return self.moment

    def _check_link(self, now: float) -> None:
        pass


class Served:
    """One plant in real time from the moment `clock.start` on.

    `advance` advances it to the present; a request then takes effect at that moment.
    """

    def __init__(self, device: DeviceRecord, clock: RealClock) -> None:
        self.device, self.clock = device, clock
        self.service = options_of(device, o.read_realtime).service
        self._bench = _Bench(device, clock)
        self.identity: Identity = self._bench.open()
        self.log = Log(self.service.log)
        self._outputs = {output.output: output for output in device.outputs}
        self._questions: dict[str, Callable[[Asker, Mapping[str, Any]], Any]] = {
            "write": self._write,
            "read_back": lambda _, q: self._bench.read_back(str(q["output"])),
            "follow": self._follow,
            "halt": self._halt,
            "switch": self._switch,
            "is_on": lambda _, q: self._bench.is_on(str(q["output"])),
            "level": lambda _, q: self._bench.level(str(q["name"])),
            "place": self._place,
            "start": self._start,
            "stop": lambda _, q: self._bench.stop(),
            "rescue": self._rescue,
            "arm": self._arm,
            "feed": lambda _asker, _question: self._refuse_fired(),
            "disarm": self._disarm,
            "held": lambda _a, _q: {"watchdog": self._watchdog, "uptime": time.monotonic() - self._started},
        }
        self._events: dict[str, Callable[[Any], None]] = {
            "restart": lambda _value: self._restart(),
            "watchdog-off": lambda _value: self._switch_off_watchdog(),
            "setpoint": self._change_set_point,
        }
        self._started = time.monotonic()
        self._sampler = 0
        """Process that last began to sample; 0 for none."""
        self._heard = 0.0
        self._watchdog = 0.0
        self._fired: float | None = None

    # -- time -----------------------------------------------------------------------------------------------------

    def advance(self, now: float) -> None:
        """Advance the plant and the watchdog to the moment `now` [s, CLOCK_MONOTONIC]."""
        self._bench.moment = max(self._bench.moment, round(now - self.clock.start, 9))
        self._bench.simulation()
        if self._watchdog and now - self._heard > self._watchdog:
            self.vent("watchdog", silent=now - self._heard)
            self._watchdog, self._fired = 0.0, now

    def vent(self, why: str, **data: Any) -> None:
        """Vent by itself: valves not energised, set-points to their safe values; `why` is logged."""
        for valve in self.device.valves:
            self._bench.switch(valve.output, on=False)
        for output in self.device.outputs:
            self._bench.write(output.output, float(output.scale.to_raw(output.safe)))
        self.log.write(why, **data, pressure=self.pressure)

    @property
    def faults(self) -> o.Faults:
        """Present faults."""
        return self._bench.simulation().faults

    @property
    def now(self) -> float:
        """The moment that the plant has reached, on its own time, which dates the faults [s]."""
        return self._bench.moment

    @property
    def pressure(self) -> float:
        """Actual pressure in the muscle [Pa]."""
        return self._bench.simulation().pressure

    # -- questions ------------------------------------------------------------------------------------------------

    def hear(self, now: float) -> None:
        """Note that a request arrived, which feeds the watchdog."""
        self._heard = now

    def answer(self, asker: Asker, question: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        """Carry out a request; returns head and payload of its answer, and raises DeviceError if it is refused."""
        if (do := str(question.get("do"))) == "collect":
            return self._collect(asker)
        if do not in self._questions:
            raise DeviceError(self.device.name, f'no command "{do}"{did_you_mean(do, self._questions)}')
        return {"value": self._questions[do](asker, question)}, b""

    def _start(self, asker: Asker, question: Mapping[str, Any]) -> float:
        self._sampler = asker.pid
        return self._bench.start(float(question["rate"]))

    def _collect(self, asker: Asker) -> tuple[dict[str, Any], bytes]:
        if self._sampler not in {0, asker.pid}:
            other = (
                f"is sampled by another program now (process {self._sampler}), and gives its samples to one at a time"
            )
            remedy = "end that one, or give this bench's device another address"
            raise DeviceError(self.device.name, f"{other}: {remedy}")
        block = self._bench.collect()
        shift = round((self.clock.start - asker.zero) * 1e9)
        moments = (np.asarray(block.time, dtype="<i8") + shift).astype("<i8")
        columns = [np.asarray(column, dtype="<f8").tobytes() for column in block.columns.values()]
        head = {"rows": len(block.time), "columns": list(block.columns)}
        return head, b"".join([moments.tobytes(), *columns])

    def _write(self, asker: Asker, question: Mapping[str, Any]) -> None:
        output, value = o.output_of(self.device, str(question["output"])), float(question["value"])
        safe = float(output.scale.to_raw(output.safe))
        if abs(value - safe) > max(output.resolution, 1e-9 * abs(safe)):
            self._refuse_fired()
        self._bench.write(output.output, value)
        held = float(output.scale.to_si(self._bench.read_back(output.output)))
        self._note(asker, "write", output=output.output, si=float(output.scale.to_si(value)), held=held)

    def _follow(self, asker: Asker, question: Mapping[str, Any]) -> None:
        self._refuse_fired()
        output = o.output_of(self.device, str(question["output"]))
        given = {**question["segment"]}
        given["start"] = float(given["start"]) + asker.zero - self.clock.start
        segment = Segment(**given)
        self._bench.follow(output.output, segment)
        scale = output.scale
        self._note(
            asker,
            "follow",
            output=output.output,
            kind=segment.kind,
            start=segment.start + self.clock.start,
            origin=float(scale.to_si(segment.origin)),
            target=float(scale.to_si(segment.target)) if segment.kind == "ramp" else None,
            rate=segment.rate * scale.slope,
            amplitude=segment.amplitude * scale.slope,
            frequency=segment.frequency,
            cycles=segment.cycles,
        )

    def _halt(self, asker: Asker, question: Mapping[str, Any]) -> None:
        output = o.output_of(self.device, str(question["output"]))
        self._bench.halt(output.output)
        held = float(output.scale.to_si(self._bench.read_back(output.output)))
        self._note(asker, "halt", output=output.output, held=held)

    def _switch(self, asker: Asker, question: Mapping[str, Any]) -> None:
        output, on = str(question["output"]), bool(question["on"])
        if on:
            self._refuse_fired()
        self._bench.switch(output, on=on)
        self._note(asker, "switch", output=output, on=on)

    def _rescue(self, asker: Asker, question: Mapping[str, Any]) -> None:
        if question["output"] in self._outputs:
            self._write(asker, question)
        else:
            self._switch(asker, {"output": question["output"], "on": float(question["value"]) >= 0.5})

    def _place(self, asker: Asker, question: Mapping[str, Any]) -> None:
        load = Load(float(question["force"]), float(question["mass"]))
        self._bench.place(load)
        self._note(asker, "place", force=load.force, mass=load.mass)

    def _note(self, asker: Asker, do: str, **data: Any) -> None:
        who = {"from": asker.number, "role": asker.role, "pid": asker.pid}
        self.log.write(do, **data, pressure=self.pressure, **who)

    # -- watchdog -------------------------------------------------------------------------------------------------

    def _arm(self, asker: Asker, question: Mapping[str, Any]) -> float:
        low, high = WATCHDOG
        wanted = float(question["seconds"])
        if not low <= wanted <= high:
            raise DeviceError(self.device.name, f"its watchdog takes {low:g} s to {high:g} s, not {wanted:g} s")
        self._watchdog, self._fired = round(wanted, 2), None
        self._note(asker, "arm", seconds=self._watchdog)
        return self._watchdog

    def _disarm(self, asker: Asker, question: Mapping[str, Any]) -> None:
        self._switch_off_watchdog()
        self._note(asker, "disarm")

    def _refuse_fired(self) -> None:
        if self._fired is not None:
            ago = time.monotonic() - self._fired
            raise DeviceError(self.device.name, f"its watchdog has vented {ago:.3g} s ago; arm it again first")

    # -- for tests ------------------------------------------------------------------------------------------------

    def inject(self, question: Mapping[str, Any]) -> None:
        """`{"fault": "burst", "after": 0.5}`, ended with `"after": null`; `{"errors": {input: {...} or null}}`.

        Events, which happen once and at once: `{"fault": "restart"}`, `"watchdog-off"`, `"setpoint"` with a `value`.
        """
        simulation, name = self._bench.simulation(), self.device.name
        if question.get("fault") in self._events:
            self._events[str(question["fault"])](question.get("value"))
            self.log.write("fault", fault=question["fault"], value=question.get("value"))
        elif "fault" in question:
            fault = o.fault_name(name, str(question["fault"]))
            after = question.get("after", 0.0)
            simulation.fail(fault, None if after is None else simulation.time + float(after))
            self.log.write("fault", fault=fault.removesuffix("_at"), after=after)
        errors = question.get("errors", {})
        given = {channel: error for channel, error in errors.items() if error is not None}
        read = options_of(self.device, lambda _, reader: o.sensor_errors(reader, given, ("errors",)))
        for channel, error in errors.items():
            simulation.disturb(channel, read.get(channel))
            self.log.write("fault", errors={channel: error})

    def _restart(self) -> None:
        """Reset to power-on: vented, watchdog off, not sampling."""
        self.vent("restart")
        self._bench.stop()
        self._switch_off_watchdog()
        self._started = time.monotonic()

    def _switch_off_watchdog(self) -> None:
        self._watchdog, self._fired = 0.0, None

    def _change_set_point(self, value: Any) -> None:
        """Command the first output [device units], as another program would."""
        self._bench.write(next(iter(self._outputs)), float(value))

    def state(self) -> dict[str, Any]:
        """The state of the plant, in SI, despite errors of its link and sensors."""
        simulation = self._bench.simulation()
        return {
            "pressure": simulation.pressure,
            "setpoints": {name: simulation.setpoint(name) for name in self._outputs},
            "energised": simulation.energised,
            "fired": self._fired,
        }
