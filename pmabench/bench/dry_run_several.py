"""A bench with several muscles as options, inputs and valves of the simulated joint or platform; opens nothing.

The muscles are those of paper 3 (modified Daerden) of the specimen's diameter, length and braid angle; the rest is as
the bench file describes it. Knows no kind of test.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show, without_number
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ValveRecord
from pmabench.model.published_muscles import USUAL_ANGLE as BRAID_ANGLE

DUMP, SUPPLY = "dump_valve", "supply_valve"
SAME = ("angle", "torque", "supply", "acceleration_x", "acceleration_y", "acceleration_z", "turn_x", "turn_y")
"""Channels that are inputs of the simulated bench by the same name."""


def inputs(mounted: Mounted) -> dict[str, str]:
    """Channel of a bench with several muscles -> input of the simulated one."""
    found = {name: name for name in SAME}
    if driven(mounted):
        found["angle_command"] = "angle_set"
    for number in mounted.bench_file.muscles:
        found[f"pressure_{number}"] = f"pressure_{number}"
        if mounted.bench_file.joint is not None:
            found[f"pressure_command_{number}"] = f"pressure_{number}_set"
    return found


def driven(mounted: Mounted) -> bool:
    """Whether a drive turns the joint."""
    return any(output.name == "angle" for output in mounted.bench.outputs)


def valve_output(valve: ValveRecord) -> str:
    """Which valve of the simulated bench takes its place: its own name, or the one before all muscles."""
    return valve.name if valve.longest or without_number(valve.name)[0] == DUMP else SUPPLY


def several(mounted: Mounted) -> tuple[dict[str, Any], str]:
    """Options of the mock driver, and in words whose muscles these are.

    Raises UsageError where the bench file does not say what the joint is made of, or has another free end.
    """
    file, specimen = mounted.bench_file, mounted.specimen_file
    angle = specimen.braid_angle if specimen.braid_angle is not None else BRAID_ANGLE
    muscle = {
        "diameter": specimen.inner_diameter,
        "length": specimen.mounted.length or specimen.nominal_length,
        "braid_angle": angle,
        "atmosphere": file.air.atmosphere,
    }
    if file.platform is not None:
        options: dict[str, Any] = {"plant": "platform", "built": {**muscle, **mounted.bench.platform}}
    elif file.joint is not None:
        options = {"plant": "joint", "built": {**muscle, **_joint(mounted)}}
    else:
        raise UsageError(
            f'"{file.name}" has several muscles that turn neither a joint nor a platform, and nothing else of several '
            "muscles can be simulated: check without --simulate, which still checks limits and times of the plan"
        )
    options["free_end"] = "actuator" if driven(mounted) else "weights"
    assumed = "" if specimen.braid_angle is not None else " (assumed)"
    source = (
        f"{len(file.muscles)} muscles of paper 3 of {show(specimen.inner_diameter, 'length')} and "
        f"{show(angle, 'angle')}{assumed}, of whose force a muscle has between half and all; hysteresis, damping, "
        "inertia, regulators and valves assumed"
    )
    return options, source


def _joint(mounted: Mounted) -> Mapping[str, float]:
    joint = mounted.bench_file.joint
    found = {} if joint is None else {"pulley": joint.pulley, "contraction": joint.contraction}
    numbers = {name: value for name, value in found.items() if value is not None}
    if missing := sorted(set(found) - set(numbers)):
        raise UsageError(
            f'"{mounted.bench.name}" does not say on which radius its muscles pull and how far they are contracted at '
            f"angle 0 ({' and '.join(missing)} missing), and a joint cannot be simulated without: add "
            '"pulley: 25 mm, contraction: 10 %" with your numbers to "joint" in the bench file'
        )
    return numbers
