"""NI multifunction devices like the USB-6215, through NI-DAQmx on this computer or behind NI's gRPC server.

`options`: what the bench file says; `connection`: the only part that knows NI's package `nidaqmx`; `driver`: the device
interface; `emulated`, `emulated_tasks`: NI's server with one device in front of the simulated muscle.
"""

from pmabench_drivers.ni_daq.driver import NiDaq

__all__ = ["NiDaq"]
