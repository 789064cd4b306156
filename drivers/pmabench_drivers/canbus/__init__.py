"""A CAN bus: CiA 402 drives, CiA 406 transducers and sensors described by a DBC file.

`frames` knows CANopen's frames and the state machine of a drive, `link` the adapters, and puts what comes in together
to samples; `node`: what all nodes share, and a transducer; `drive`: one drive; `options`: what the bench file says, and
the DBC file; `driver` is the device interface. `emulated*` are the other side of the wire.
"""

from pmabench_drivers.canbus.driver import CanBus

__all__ = ["CanBus"]
