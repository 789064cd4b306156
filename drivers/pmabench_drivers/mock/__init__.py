"""The mock bench: the simulated plant behind the driver interface, in process.

`options`: options of a bench file; `simulation`: one muscle, a joint, a platform, based on `sampled`, which has what
they share; here: the device interface, without physics. `client`, `server`, `served`: the same in a separate process,
in real time.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

from pmabench.base.clock import Clock, RealClock, VirtualClock
from pmabench.bench.interface import Block, DeviceRecord, Identity, Load, OutputRecord, Segment
from pmabench_drivers.mock.options import E_STOP, JOINT, PLATFORM, output_of, read_options
from pmabench_drivers.shared.device import Driver, refuse_nonsense

if TYPE_CHECKING:
    from pmabench_drivers.mock.simulation import JointSimulation, PlatformSimulation, Simulation

    AnySimulation: TypeAlias = Simulation | JointSimulation | PlatformSimulation


class MockBench(Driver[Any]):
    """A bench with the simulated plant in it: streams, takes set-points, ramps and sines, and places loads.

    With the plant `joint` there are two muscles, with `platform` three: see `pmabench_drivers.mock.simulation`.
    With all others:
    Channel inputs: `pressure`, `displacement`, `force`, `supply`, and the set-points as the device holds them before
    the dead time, `pressure_set` and (free end driven) `displacement_set`. Outputs: `pressure` and (free end driven)
    `displacement`; the valve `dump_valve`, present if the bench names it, which is open and empties the muscle whatever
    the regulator does, unless it is energised; and `isolation_valve`, present if named, which is shut unless it is
    energised. Digital input: `e_stop`.
    Options: `pmabench_drivers.mock.options.Options`. Bench time is the clock's: every call first advances the plant to
    it, and if the clock was set back, the plant goes back too. After setting the clock back, call `collect` (which then
    returns nothing) before time continues: a jump back and forth between two calls is not noticed.
    """

    verified = "a simulation"
    read_options = staticmethod(read_options)
    _link: AnySimulation | None
    """The plant."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._closed = threading.Event()

    def open(self) -> Identity:
        """Build the plant at rest, without pressure, the load support under the carriage."""
        from pmabench_drivers.mock.sampled import MEMORY
        from pmabench_drivers.mock.simulation import JointSimulation, PlatformSimulation, Simulation

        with self._refused():
            memory = 0.0 if isinstance(self._clock, RealClock) else MEMORY
            several: dict[str, type[AnySimulation]] = {JOINT: JointSimulation, PLATFORM: PlatformSimulation}
            made = several.get(self._options.plant, Simulation)
            self._link = made(self._device, self._options, self._now(), memory)
        self._closed.clear()
        options = self._options
        return Identity("pmabench", f"mock {options.plant} {options.preset}", str(options.seed), "1", simulated=True)

    def close(self) -> None:
        """Drop the plant."""
        self._link = None
        self._closed.set()

    def start(self, rate: float) -> float:
        """Start sampling: sample 0 is taken now, sample k at k / rate later; any rate above 0 [Hz] is kept exactly."""
        self._refuse_rate(rate)
        self.simulation().start(rate)
        return rate

    def collect(self) -> Block:
        """All samples due by now and not yet collected."""
        opened, now = self._linked()
        return opened.collect(now, _moment(self._clock.quiet_until) if isinstance(self._clock, VirtualClock) else now)

    def stop(self) -> None:
        """Stop sampling."""
        if self._link is not None:
            self._link.stop()

    def write(self, output: str, value: float) -> None:
        """Command a value [device units] at once."""
        record = output_of(self._device, output, value)
        self._command(output, Segment("constant", self._now(), value), record)

    def read_back(self, output: str) -> float:
        """Present set-point [device units]."""
        record = output_of(self._device, output)
        return float(record.scale.to_raw(self.simulation().setpoint(output)))

    def follow(self, output: str, segment: Segment) -> None:
        """Follow a ramp or a sine from its start, or from now if that has passed."""
        record = output_of(self._device, output)
        refuse_nonsense(self._device.name, output, segment)
        self._command(output, segment, record)

    def halt(self, output: str) -> None:
        """Stop and hold: the actuator at its place, the regulator at its set-point."""
        output_of(self._device, output)
        self.simulation().halt(output)

    def switch(self, output: str, *, on: bool) -> None:
        """Energise a valve or not."""
        self._valve(output)
        self.simulation().switch(output, on=on)

    def pulse(self, output: str, seconds: float) -> None:
        """Open a valve of a platform for `seconds` from now."""
        self._valve(output)
        with self._refused(output):
            self.simulation().pulse(output, seconds)

    def is_on(self, output: str) -> bool:
        """Whether a valve is energised."""
        self._valve(output)
        return self.simulation().is_on(output)

    def level(self, name: str) -> bool:
        """Whether the emergency stop's contact is closed, which holds the input high."""
        self._known("digital input", name, [E_STOP])
        return self.simulation().e_stop_high()

    def place(self, load: Load) -> None:
        """Put `load` on the free end; no effect if an actuator holds it."""
        self.simulation().place(load)

    def _command(self, output: str, segment: Segment, record: OutputRecord) -> None:
        with self._refused(output):
            self.simulation().command(output, segment, record.scale)

    @contextmanager
    def _refused(self, output: str = "") -> Iterator[None]:
        """Raise what the plant refuses as DeviceError."""
        try:
            yield
        except ValueError as error:
            raise self._error(str(error), output) from error

    def _valve(self, output: str) -> None:
        self._known("valve", output, (valve.output for valve in self._device.valves))

    def _now(self) -> float:
        return _moment(self._clock.now())

    def simulation(self) -> AnySimulation:
        """The simulation, advanced to the clock's time: the true values behind the driver's."""
        opened, now = self._linked()
        opened.catch_up(now)
        return opened

    def _linked(self) -> tuple[AnySimulation, float]:
        """The simulation, if its link works, and the clock's time [s]."""
        simulation, now = self._opened(), self._now()
        self._check_link(now)
        return simulation, now

    def _check_link(self, now: float) -> None:
        """Apply simulated faults of the link: hang, or raise DeviceError."""
        faults = self._options.faults
        if faults.hang_at is not None and now >= faults.hang_at:
            self._closed.wait()
            raise self._error("closed while it did not answer (simulated fault)")
        if faults.lost_at is not None and now >= faults.lost_at:
            raise self._error("link lost (simulated fault)")


def _moment(t: float) -> float:
    """Like `to_nanosecond`, which would import numpy."""
    return round(t * 1e9) / 1e9
