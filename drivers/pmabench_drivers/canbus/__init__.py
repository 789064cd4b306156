"""A CAN bus: CiA 402 drives, CiA 406 transducers and sensors described by a DBC file.

`frames` knows CANopen's frames, `link` the adapters, `node` what all nodes share, and a transducer; `cia402` is the
state machine of a drive, `drive` one drive; `dbc` reads DBC files; `options`: what the bench file says; `rows` puts
what comes in together to samples; `driver` is the device interface. `emulated*` are the other side of the wire.
"""

from pmabench_drivers.canbus.driver import CanBus

__all__ = ["CanBus"]
