"""The plant of the mock in real time, for several wires at once, and the wiring of one device's terminals.

Independent of the protocol.
"""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Mapping
from typing import Any

from pmabench.base.clock import RealClock
from pmabench.bench import interface as b
from pmabench_drivers.emulator.faults import CommandLog, Faults
from pmabench_drivers.mock import MockBench
from pmabench_drivers.mock.options import ANGLE, ARM, DUMP_VALVE, E_STOP
from pmabench_drivers.mock.simulation import JointSimulation, PlatformSimulation, Simulation

RATE = 1000.0
"""Sampling rate of the plant; a reader gets the latest sample, or that of a given time [Hz]."""
KEPT = 2.0
"""How long samples are kept, for devices that choose their sampling times [s]."""
TURN = 0.5
"""Interval for updating the plant without readers [s]."""
CHANNELS = {
    "pressure": ("pressure", "pressure"),
    "displacement": ("displacement", "length"),
    "force": ("force", "force"),
    "supply": ("supply", "pressure"),
    "pressure_command": ("pressure_set", "pressure"),
}
"""Channel of a bench -> input of the mock, and quantity."""
DRIVEN = {"displacement_command": ("displacement_set", "length")}
"""Additional channels if an actuator drives the free end."""
BENT = {"angle": (ANGLE, "angle")}
"""Additional channels of an arm."""


class _Mock(MockBench):
    """The mock; after a long time without readers it computes only the last samples."""

    def rest(self) -> None:
        """Advance the plant to the oldest sample to be kept, in case nobody has read for long."""
        if self._link is not None:
            self._link.skip(self._now() - KEPT)

    def simulation(self) -> Simulation | JointSimulation | PlatformSimulation:
        """The simulation, advanced to the present."""
        self.rest()
        return super().simulation()

    def collect(self) -> b.Block:
        """Samples up to the present."""
        self.rest()
        return super().collect()


class RealPlant:
    """Muscle, regulator, load and, with `dump_valve`, a valve that empties the muscle unless it is energised.

    `plant` is a preset's name, or the contents of a plant file as in a compiled bench (`pmabench.bench.plant`).
    `driven`: an actuator holds the free end, and there are no loads. It is advanced to the present when it is read,
    and only the last `KEPT` seconds are then sampled.
    """

    def __init__(
        self,
        plant: str | Mapping[str, Any] = "paper0",
        preset: str = "bench",
        *,
        dump_valve: bool = True,
        driven: bool = False,
        seed: int = 1,
        clock: RealClock | None = None,
    ) -> None:
        inputs = CHANNELS | (DRIVEN if driven else {}) | (BENT if plant == ARM else {})
        drive = b.OutputRecord("displacement", "length", "plant", "displacement", b.Scale(), 0.0, 0.0, -0.01, 0.09)
        channels = tuple(
            b.ChannelRecord(name, quantity, "plant", source, "float64", "SI", b.Scale(), -1e9, 1e9)
            for name, (source, quantity) in inputs.items()
        )
        device = b.DeviceRecord(
            "plant",
            "pmabench_drivers.mock:MockBench",
            options={"plant": plant, "preset": preset, "seed": seed, **({"free_end": "actuator"} if driven else {})},
            channels=channels,
            outputs=(
                b.OutputRecord("pressure", "pressure", "plant", "pressure", b.Scale(), 0.0, 0.0, 0.0, 1e6),
                *((drive,) if driven else ()),
            ),
            valves=(b.ValveRecord(DUMP_VALVE, "plant", DUMP_VALVE),) if dump_valve else (),
            interlocks=(b.InterlockRecord(E_STOP, "plant", E_STOP),),
        )
        self._clock = clock or RealClock()
        self._mock = _Mock(device, self._clock)
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._mock.open()
        self._mock.start(RATE)
        self._sent = 0.0
        self._times: deque[int] = deque([0], maxlen=round(KEPT * RATE))
        self._samples: deque[tuple[float, ...]] = deque([(0.0,) * len(inputs)], maxlen=round(KEPT * RATE))
        self._names = tuple(inputs)
        self.proven = True
        """Whether the scales of the device that reads it are known independently of the bench under test."""
        self.faults = Faults()
        """Faults of the device that reads it."""

    def keep_up(self) -> None:
        """Advance it regularly, also without readers, until `close`."""
        threading.Thread(target=self._keep_up, name="emulated plant", daemon=True).start()

    def close(self) -> None:
        """Stop updating."""
        self._ended.set()

    def _keep_up(self) -> None:
        while not self._ended.wait(TURN):
            with self._lock:
                self._mock.rest()

    def seen(self, *, proven: bool = True) -> RealPlant:
        """The same plant as seen by another device; `proven`: its scales do not come from the bench under test."""
        return _Seen(self, proven=proven)

    def model(self, name: str) -> str:
        """Name that an emulated device in front of it reports over its wire."""
        return f"{b.EMULATED if self.proven else b.UNPROVEN}{name}"

    def quantities(self) -> dict[str, float]:
        """Present measured value of each channel of a bench [SI], with noise."""
        with self._lock:
            self._collect()
            return dict(zip(self._names, self._samples[-1], strict=True))

    def at(self, moment: float) -> dict[str, float]:
        """Measured value of each channel at a time within the last `KEPT` seconds [s, monotonic]: the sample before it.

        For devices with their own clock: they lose nothing when this computer is late.
        """
        with self._lock:
            time_ns = round((moment - self._clock.start) * 1e9)
            if self._times[-1] < time_ns:
                self._collect()
            place = max(0, bisect_right(self._times, time_ns) - 1)
            return dict(zip(self._names, self._samples[place], strict=True))

    def _collect(self) -> None:
        block = self._mock.collect()
        self._times.extend(int(time) for time in block.time)
        columns = [block.columns[name] for name in self._names]
        self._samples.extend(tuple(float(value) for value in row) for row in zip(*columns, strict=True))

    def command(self, pressure: float) -> None:
        """Set the regulator's set-point [Pa]."""
        with self._lock:
            self._mock.write("pressure", min(max(pressure, 0.0), 1e6))

    def switch(self, *, on: bool) -> None:
        """Energise the dump valve or not."""
        with self._lock:
            self._mock.switch(DUMP_VALVE, on=on)

    def dump_open(self) -> bool:
        """Whether the dump valve empties the muscle."""
        with self._lock:
            return self._mock.simulation().dump_open

    def drive(self, position: float, speed: float = 0.0, origin: float | None = None) -> None:
        """Send the actuator to a position [m of contraction]: at once, or at `speed` [m/s] from `origin`.

        By default the origin is its last commanded position.
        """
        with self._lock:
            origin, self._sent = self._sent if origin is None else origin, position
            if speed > 0 and position != origin:
                segment = b.Segment("ramp", self._clock.now(), origin, position, rate=speed)
                self._mock.follow("displacement", segment)
            else:
                self._mock.write("displacement", position)

    def stop_drive(self) -> float:
        """Stop the actuator at its present position, which is returned [m of contraction]."""
        with self._lock:
            self._mock.halt("displacement")
            self._sent = self._mock.read_back("displacement")
            return self._sent

    def load(self, force: float, mass: float) -> None:
        """Set the load on the free end [N], [kg]."""
        with self._lock:
            self._mock.place(b.Load(force, mass))

    def e_stop_high(self) -> bool:
        """Whether the emergency stop is not pressed."""
        with self._lock:
            return self._mock.level(E_STOP)

    def fail(self, fault: str, *, over: bool = False) -> None:
        """Start a fault of the mock, such as `burst_at` or `e_stop_at`, or end it (`over`)."""
        with self._lock:
            simulation = self._mock.simulation()
            simulation.fail(fault, None if over else simulation.time)


class _Seen(RealPlant):
    """The plant as seen by one device: constant with its fault `stuck`."""

    def __init__(self, plant: RealPlant, *, proven: bool) -> None:
        self.__dict__.update(plant.__dict__)
        self._plant, self._stuck = plant, dict[str, float]()
        self.proven = proven

    def quantities(self) -> dict[str, float]:
        """The plant's quantities; of a stuck device those at which it stuck."""
        return self._shown(self._plant.quantities())

    def at(self, moment: float) -> dict[str, float]:
        """The plant's quantities; of a stuck device those at which it stuck."""
        return self._shown(self._plant.at(moment))

    def _shown(self, found: dict[str, float]) -> dict[str, float]:
        if self.faults.peek().kind != "stuck":
            self._stuck = {}
            return found
        self._stuck = self._stuck or found
        return dict(self._stuck)


class Wiring:
    """Channels, outputs, valves and contacts by the names of their terminals."""

    def __init__(self, device: b.DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self._name, self._plant, self._log = device.name, plant, log
        self.channels = {channel.input: channel for channel in device.channels}
        self.outputs = {output.output: output for output in device.outputs}
        self.valves = {valve.output: valve for valve in device.valves}
        self.locks = {lock.input: lock for lock in device.interlocks}

    @property
    def first_output(self) -> str:
        """Terminal of the bench's first output of this device; empty without one."""
        return next(iter(self.outputs), "")

    def raw(self, terminal: str, quantities: Mapping[str, float], *, calibrated: bool = False) -> float:
        """Reading of a terminal for quantities of the plant [raw]; 0 without a wire."""
        if (channel := self.channels.get(terminal)) is None:
            return 0.0
        scale = channel.calibrated if calibrated else channel.scale
        return float(scale.to_raw(quantities.get(channel.name, 0.0)))

    def level(self, terminal: str) -> bool:
        """Whether the contact at a terminal makes it high; low without a wire."""
        if (lock := self.locks.get(terminal)) is None:
            return False
        closed = self._plant.e_stop_high() if "stop" in lock.name else True
        return closed == (lock.safe == "high")

    def set(self, terminal: str, raw: float, *, reached: float | None = None, **more: Any) -> None:
        """Log and carry out a command; the plant gets the value `reached` if that differs from `raw`."""
        if (output := self.outputs.get(terminal)) is not None:
            self._log.note("set", self._name, output=output.name, raw=raw, si=float(output.scale.to_si(raw)), **more)
            if not more.get("held"):
                self.give(terminal, raw if reached is None else reached)

    def give(self, terminal: str, raw: float) -> None:
        """Set the value at a terminal from now on [raw], without an entry in the log."""
        output = self.outputs.get(terminal)
        if output is not None and output.quantity == "pressure":
            self._plant.command(float(output.scale.to_si(raw)))

    def switch(self, terminal: str, *, on: bool, **more: Any) -> None:
        """Log and carry out a command for a valve."""
        if (valve := self.valves.get(terminal)) is not None:
            self._log.note("switch", self._name, valve=valve.name, on=on, **more)
            if not more.get("held"):
                self.drive(terminal, on=on)

    def drive(self, terminal: str, *, on: bool) -> None:
        """Energise the valve at a terminal or not, without an entry in the log."""
        valve = self.valves.get(terminal)
        if valve is not None:
            self._plant.switch(on=on == (valve.energised == "closed"))
