"""Files that people write about a bench as strict models, each checked by itself.

`bench` is the station, with `safety` (limits, watch list, safe state) and `session`; `specimen` the muscle, the
calibration of one channel, and values that all files share; `plant` the muscle of a simulated bench.
"""
