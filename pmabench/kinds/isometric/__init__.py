"""Isometric tests of other programs: the line F = m P + c at each contraction.

- `reduction`, with what sensors and sampling make of a line
"""

from dataclasses import replace

from pmabench.base.kind import Imported, Kind, Result

RESULTS = (
    Result("F", "force", "force"),
    Result("m", "slope of force over pressure", "force per pressure", headline=True),
    Result("c", "intercept of force over pressure", "force"),
)
PULL = Kind(
    name="recorded-pull",
    title="Recorded pulls at set pressure",
    order=131,
    results=RESULTS,
    reduction="pmabench.kinds.isometric.reduction:reduce",
    word="recorded pull",
    offers="pmabench.kinds.isometric.reduction:offers",
    figures={"isometric": "pmabench.plotting.motion:isometric"},
    front={"isometric": "pmabench.plotting.motion:isometric"},
    published={"isometric": ("pressure", "force", "displacement")},
    parts={"slow rows": "pmabench.analysis.surface.trials:by_hand"},
    imported=Imported(recording=True, follows="force", shown="pauses"),
)
KIND = replace(
    PULL,
    name="isometric",
    title="Isometric force over pressure",
    order=130,
    papers=("paper 4",),
    word="recorded isometric",
    also=(PULL,),
    imported=Imported(recording=True, follows="force", point=("contraction",), held=True, shown="held length"),
)
