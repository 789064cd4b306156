"""Sines of pressure recorded by other programs: amplitudes, phase, loop, bandwidth.

- `reduction`; `form`: departures from a steady sine, and the bandwidth
"""

from pmabench.base.kind import Imported, Kind, Result

RESULTS = (
    Result("P", "amplitude of the pressure", "pressure", headline=True),
    Result("x", "amplitude of the contraction", "length", headline=True),
    Result("P/x", "pressure per contraction", "gain", headline=True),
    Result("phi_x", "phase of contraction after pressure", "angle", headline=True),
    Result("H", "width of the loop of contraction over pressure", "length", headline=True),
    Result("P/P_set", "pressure per commanded pressure", "ratio", headline=True),
    Result("phi_P", "phase of pressure after its command", "angle"),
    Result("f_b", "bandwidth under commanded pressure, −3 dB", "frequency", headline=True, positive=True),
)
METHODS = {
    "bandwidth, by sines of command": (
        "Where the gain of recorded sines from commanded pressure to contraction has fallen by 3 dB from that of the "
        "slowest; between two frequencies 1/|G|² is a line over f², as it is for one lag."
    ),
    "bandwidth, by sines of pressure": (
        "The same with the measured pressure, for want of its command: that of the muscle alone."
    ),
}
KIND = Kind(
    name="recorded-sine",
    title="Recorded sines of pressure",
    order=150,
    results=RESULTS,
    reduction="pmabench.kinds.recorded_sine.reduction:reduce",
    methods=METHODS,
    figures={"pressure-loop": "pmabench.plotting.motion:loops"},
    front={"pressure-loop": "pmabench.plotting.motion:loops"},
    parts={"slow rows": "pmabench.analysis.surface.trials:hanging"},
    imported=Imported(recording=True, follows="displacement", point=("frequency",), shown="sine"),
)
