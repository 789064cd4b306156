"""A CAN bus: CiA 402 drives, CiA 406 transducers and sensors described by a DBC file.

`frames` knows CANopen's frames, `link` the adapter, `sdo` questions to a node's object dictionary, `node` what all
nodes share; `cia402` is the state machine of a drive, `drive` one drive, `transducer` one transducer; `dbc` reads DBC
files; `rows` puts what answers to one SYNC together; `driver` is the device interface. `hub` and `emulated*` are the
other side of the wire.
"""

from pmabench_drivers.canbus.driver import CanBus

__all__ = ["CanBus"]
