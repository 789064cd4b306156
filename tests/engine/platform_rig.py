"""The shipped bench with a platform, and a look inside its plant: what was switched, and where the platform really is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from pmabench_drivers.mock import MockBench

from pmabench.base.clock import Clock
from pmabench.bench.compile import Mounted, mount
from pmabench.bench.interface import Block, DeviceRecord, Identity

ROOT = Path(__file__).resolve().parents[2]
BENCH, SPECIMEN = ROOT / "fixtures/benches/mock-platform.yaml", ROOT / "fixtures/specimens/platform-daerden.yaml"
SHIPPED = mount(BENCH, SPECIMEN)
AIMS = {aim.name: (aim.low, aim.high) for aim in SHIPPED.bench.aims}


class Watched(MockBench):
    """The mock, which notes what it is told, and the truth at each sample."""

    made: ClassVar[list[Watched]] = []

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self.reported: list[tuple[float, str, bool]] = []
        """Time [s], valve and position of everything that was switched."""
        self.course: list[tuple[float, float, float]] = []
        """Time [s], phi and psi [rad] whenever samples were collected."""
        self.plant: Any = None
        Watched.made.append(self)

    def open(self) -> Identity:
        """Keeps hold of the plant, which is looked at after the run."""
        identity = super().open()
        self.plant = self.simulation()._plant
        return identity

    def switch(self, output: str, *, on: bool) -> None:
        """Noted."""
        self.reported.append((self._clock.now(), output, on))
        super().switch(output, on=on)

    def collect(self) -> Block:
        """With the attitude at the newest sample."""
        block = super().collect()
        self.course.append((self.plant.time, *self.plant.state[:2]))
        return block


def mounted(**options: Any) -> Mounted:
    """The bench, with options of its mock."""
    (device,) = SHIPPED.bench.devices
    watched = replace(device, driver=f"{__name__}:Watched", options={**device.options, **options})
    return replace(SHIPPED, bench=replace(SHIPPED.bench, devices=(watched,)))
