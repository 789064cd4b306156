"""What every driver must keep, tried against the driver's own emulator; for shipped drivers and for those of others.

`suite.py` is the table of checks and runs them. `unopened` looks at the class alone, `behaviour` at an open device,
`broken_wire` and `hostile` at what it does when the wire is bad. `rig` stands up emulator and driver, and measures how
long calls take; between the two stands a `relay` (TCP or serial) that does to the bytes what `damage` says.

Nothing is ever tried on a device that does not say over its wire that it is emulated.
"""
