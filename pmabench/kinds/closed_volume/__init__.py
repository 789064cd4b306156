"""Volume of a muscle over contraction: filled, shut off and contracted slowly.

- `reduction`, made of `stroke`, with figure and one trial on the display
- protocol files: `protocol`
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("V", "volume inside the muscle", "volume", headline=True),
    Result("D_0", "free diameter", "length", headline=True),
    Result("theta_0", "braid angle at the nominal length", "angle", headline=True),
    Result("alpha", "exponent of S(ε)", "count", headline=True),
)
METHODS = {
    "closed, leak taken out": (
        "P V^k of the air shut in is constant, P absolute, from the volume at the start of the stroke; what leaks into "
        "the room follows from the pressure back at the start. Mean of both directions."
    ),
    "closed, as printed": "As closed, leak taken out, with no leak: V = V0 P0/P of paper 3.",
    "closed, V(eps)": (
        "V = (π/4) D0² l0 [1/sin² θ0 − (1 − ε)^α/tan² θ0] (1 − ε) of paper 3, least squares through the volumes of all "
        "start pressures, what leaked taken out."
    ),
}
KIND = Kind(
    name="closed-volume",
    title="Closed volume",
    order=90,
    results=RESULTS,
    reduction="pmabench.kinds.closed_volume.reduction:reduce",
    papers=("paper 3, closed muscle",),
    protocol="pmabench.kinds.closed_volume.protocol:ClosedVolume",
    live="pmabench.kinds.closed_volume.reduction:one_trial",
    moves="displacement",
    regulated=False,
    methods=METHODS,
    figures={"volume": "pmabench.kinds.closed_volume.reduction:volumes"},
)
