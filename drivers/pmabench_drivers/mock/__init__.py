"""The mock bench: the simulated plant behind the driver interface, in process; knows no protocol, no unit of people."""

from pmabench_drivers.mock.driver import MockBench

__all__ = ["MockBench"]
