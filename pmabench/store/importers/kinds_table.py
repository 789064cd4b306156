"""What each kind needs of a file; each entry belongs into the record of its kind."""

from __future__ import annotations

from pmabench.base.imported import Commanded, Imported

KINDS: dict[str, Imported] = {
    "isometric": Imported(recording=True, follows="force", point=("contraction",), held=True, shown="held length"),
    "recorded-step": Imported(recording=True, follows="displacement", timed=True, shown="steps"),
    "recorded-sine": Imported(recording=True, follows="displacement", point=("frequency",), shown="sine"),
    "recorded-pull": Imported(recording=True, follows="force", shown="pauses"),
    "contraction-relaxation": Imported(
        Commanded(
            "pressure",
            phases=(("rises", "contract"), ("to the lowest", "vent"), ("any", "relax")),
            point=(("pressure", "highest"),),
        ),
        follows="displacement",
        loaded=True,
        shown="numbered trials",
    ),
    "static-load": Imported(
        Commanded("pressure", phases=(("rises", "lift"), ("any", "set-down"))),
        follows="displacement",
        loaded=True,
        lifted=True,
    ),
    "sinusoidal-displacement": Imported(
        Commanded(
            "displacement",
            point=(("frequency", "frequency"), ("mean", "mean"), ("amplitude", "amplitude"), ("pressure", "held")),
            sine=True,
        )
    ),
    "isobaric-ramp": Imported(
        Commanded(
            "displacement",
            phases=(("rises", "contract"), ("any", "expand")),
            point=(
                ("lower", "lowest end"),
                ("upper", "highest end"),
                ("speed", "speed"),
                ("cycles", "pairs"),
                ("pressure", "held"),
            ),
        )
    ),
    "isometric-pressurisation": Imported(
        Commanded(
            "pressure",
            phases=(("to the highest", "fill"), ("from the highest", "empty"), ("any", "rest")),
            point=(("contraction", "length"),),
        ),
        follows="force",
    ),
    "step-displacement": Imported(
        Commanded(
            "displacement",
            phases=(("away", "step"), ("any", "back")),
            point=(("start", "first"), ("step", "size"), ("speed", "speed"), ("pressure", "held")),
            ramps=True,
        )
    ),
    "free-contraction": Imported(
        Commanded(
            "pressure",
            phases=(("leaves", "vent"), ("rises", "fill"), ("any", "empty")),
            point=(("pressure", "reached"), ("side", "side")),
            ramps=True,
            still=True,
        ),
        follows="displacement",
    ),
    "ultimate-gain": Imported(),
    "positioning": Imported(),
    "validation": Imported(),
    "closed-volume": Imported(),
    "arm-angle": Imported(),
}
LOOPS = ("ultimate-gain", "positioning")
"""Kinds whose loop acted on the values of the calibration: another one does not show what it would have done."""
