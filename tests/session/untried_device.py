"""A driver of the simulated plant that says it is hardware, for the question about drivers that nobody tried."""

from dataclasses import replace

from pmabench_drivers.mock.client import MockClient


class SaysHardware(MockClient):
    """As the mock in real time, but no simulation by its own word."""

    verified = "emulator only"

    def open(self):
        return replace(super().open(), simulated=False, model="T7", firmware="1.0292")
