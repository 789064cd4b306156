"""Options of the mock bench in a bench file; imports no large package, uses no plant."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import DeviceRecord, OutputRecord
from pmabench.model.overrides import Overrides
from pmabench_drivers.shared.options import Place, Reader, names_in

HERE: Place = ("options",)
ANGLE = "angle"
"""Channel input of an arm: the angle of its end."""
TORQUE = "torque"
"""Channel input of a joint: torque of its muscles towards positive angles."""
PRESSURES = ("pressure_1", "pressure_2")
"""Pressures of a joint, which has two muscles; also outputs."""
OF_THREE = (*PRESSURES, "pressure_3")
"""Pressures of a platform, which has three muscles."""
ACCELERATIONS = ("acceleration_x", "acceleration_y", "acceleration_z")
TURNS = ("turn_x", "turn_y")
"""Channel inputs of a gyroscope on the platform."""
SENSORS = ("pressure", "displacement", "force", ANGLE, *OF_THREE, TORQUE, *ACCELERATIONS, *TURNS)
"""Channel inputs that are measured."""
OF_ONE = ("pressure", "displacement", "force", "supply", "pressure_set", "displacement_set", ANGLE)
"""Channel inputs of one muscle."""
FLOW = "flow"
"""Channel input of a mass flow meter: flow from the regulator into a driven muscle whose volume is known."""
INPUTS = (
    *OF_ONE, *PRESSURES, *(f"{name}_set" for name in PRESSURES), "angle_set", TORQUE, FLOW, "pressure_3",
    *ACCELERATIONS, *TURNS,
)  # fmt: skip
"""All channel inputs; their order determines the noise of each."""
ARM = "arm-30"
"""Plant that is an arm."""
JOINT = "joint"
"""Plant that is a joint of two muscles."""
PLATFORM = "platform"
"""Plant that is a platform of three muscles."""
FREE_LENGTHS = (0.15, 0.40)
"""Lengths of contractors whose length without load is in paper 2 [m]."""
DUMP_VALVE = "dump_valve"
"""Output for the dump valve."""
ISOLATION_VALVE = "isolation_valve"
"""Output for a valve between regulator and muscle: shut without power."""
VALVES = (DUMP_VALVE, ISOLATION_VALVE)
"""All valves."""
SUPPLY_VALVE = "supply_valve"
"""Output for the valve before the fill valves: shut without power."""
FILLS, EXHAUSTS = (tuple(f"{kind}_{i}" for i in (1, 2, 3)) for kind in ("fill", "exhaust"))
DUMPS = (DUMP_VALVE, *(f"{DUMP_VALVE}_{i}" for i in (1, 2, 3)))
VALVES_OF = {JOINT: (*DUMPS[:3], SUPPLY_VALVE, ISOLATION_VALVE), PLATFORM: (*FILLS, *EXHAUSTS, SUPPLY_VALVE, *DUMPS)}
"""Valves of plants with several muscles."""
OF_MUSCLES = ("diameter", "length", "braid_angle", "atmosphere", "contraction")
BUILT_OF = {
    JOINT: (*OF_MUSCLES, "pulley"),
    PLATFORM: (*OF_MUSCLES, "supply", "circle", "mass", "height", "stops", "accelerometer"),
}
"""Allowed keys of the option `built`."""
MUSCLES_OF = {JOINT: 2, PLATFORM: 3}
E_STOP = "e_stop"
"""Digital input: high while the emergency stop is not pressed."""
TEXTS, WHOLE = ("b_relax", "log"), ("seed", "faulty")
CONTRACTORS = tuple(f"contractor-{length}" for length in (15, 20, 25, 30, 40))
CHOICES = {
    "free_end": ("weights", "actuator"),
    "preset": ("ideal", "bench"),
    "plant": (
        *("paper0", "paper0-air", "serres2009", "dmsp-40-305", "daerden"),
        *(*CONTRACTORS, ARM, "real", JOINT, PLATFORM),
    ),
    "fce_eval": ("x0", "xmax"),
    "reads": SENSORS,
    "end": ("low", "high"),
    "hoses": ("straight", "crossed"),
}


@dataclass(frozen=True)
class Faults:
    """Faults and their start [s]: bench time, or in real time seconds since the plant's process began to serve.

    None for never. In real time each can also be started during the run (`pmabench_drivers.mock.server`).
    """

    burst_at: float | None = None
    """The muscle bursts: pressure falls to 0 within some 10 ms and stays there; on a platform, through a hole that is
    ten times as wide as its exhaust valve.
    """
    regulator_stuck_at: float | None = None
    """The regulator accepts set-points and ignores them: it holds its present pressure."""
    supply_lost_at: float | None = None
    """The supply is lost: the channel input `supply` reads 0, and the muscle empties backwards with a lag of 0.5 s."""
    dump_stuck_at: float | None = None
    """The dump valve no longer opens; it still closes."""
    e_stop_at: float | None = None
    """The emergency stop is pressed: the digital input `e_stop` goes low. Nothing else happens by itself."""
    fill_stuck_open_at: float | None = None
    """The fill valve of a platform's muscle stays open; likewise below."""
    fill_stuck_shut_at: float | None = None
    exhaust_stuck_open_at: float | None = None
    exhaust_stuck_shut_at: float | None = None
    leak_at: float | None = None
    """A platform's muscle leaks through a hole half as wide as its exhaust valve; one of a joint loses its air within a
    minute while its isolation valve is shut.
    """
    accelerometer_frozen_at: float | None = None
    """The accelerometer of a platform repeats its last values."""
    accelerometer_level_at: float | None = None
    """The accelerometer shows the values of a level platform, with its noise."""
    pressure_stuck_at: float | None = None
    """The pressure channel repeats one value."""
    nan_at: float | None = None
    """Every measured channel reads NaN; a channel in counts reads its lowest count."""
    gap_at: float | None = None
    """The samples of 20 ms are lost."""
    hang_at: float | None = None
    """Calls do not return until the device is closed. In real time: requests are neither answered nor carried out,
    but the second connection (`rescue`) works.
    """
    lost_at: float | None = None
    """Calls fail as if the link were cut; the second connection too."""
    dead_at: float | None = None
    """Real time only: like `hang_at`, and the second connection gets no answer either."""
    mute_at: float | None = None
    """Real time only: commands are carried out, but no answer arrives."""


@dataclass(frozen=True)
class SensorError:
    """Error of one channel input: the option `errors: {pressure: {factor: 1.02, offset: 500}}`."""

    factor: float = 1.0
    """Factor on the reading: 1.02 reads 2 % too much, -1 has the wrong sign."""
    offset: float = 0.0
    """Added after the factor [SI unit of the channel]."""
    reads: str = ""
    """The channel shows that input instead, as if two plugs were swapped. That input needs a channel, too."""
    end: str = ""
    """`low` or `high`: the channel stays at that end of its range: a broken wire, a short."""
    at: float = 0.0
    """Start [s], as in `Faults`."""


@dataclass(frozen=True)
class Service:
    """Options of the plant's own process, for the driver `mock-realtime`."""

    start: bool = True
    """Start the process if none listens at the device's address."""
    idle: float = 30.0
    """Time without a client after which it vents and ends [s]."""
    log: str = ""
    """File to which it appends the commands, as JSON lines; none by default."""


@dataclass(frozen=True)
class Options:
    """All options; numbers in SI."""

    plant: str = "paper0"
    """`paper0`, `serres2009`, `dmsp-40-305`, `contractor-15` (20, 25, 30, 40), the arm `arm-30`, `real`, or for a
    driven free end `daerden`; `joint`: two muscles on a pulley, driven with `free_end: actuator`; `platform`: three
    muscles that tilt a platform, behind valves.
    """
    numbers: Mapping[str, Any] | None = None
    """If the option `plant` names a plant file: its content, which a compiled bench has in place of the name."""
    preset: str = "bench"
    """`bench`: lag, friction, noise; `ideal`: dead time only."""
    seed: int = 1
    """Seed of the noise."""
    free_end: str = "weights"
    """`weights`: loads are placed on it; `actuator`: the free end is driven."""
    carriage: float = 2.0
    """Moving mass before a load is placed [kg]."""
    supply: float = 690e3
    """Value of the channel input `supply` [Pa]."""
    dump_lag: float = 0.1
    """First-order lag with which the muscle empties through the open dump valve [s]."""
    slow_vent: float = 1.0
    """Factor on the lags of dump valve and venting regulator: a clogged silencer [1]."""
    actuator_low: float = -10e-3
    """Smallest contraction that the actuator reaches [m]."""
    actuator_high: float = 90e-3
    """Largest contraction that the actuator reaches [m]."""
    actuator_speed: float = 0.5
    """Its highest speed [m/s]."""
    actuator_force: float = 1500.0
    """Force at which it stalls [N]."""
    faults: Faults = field(default_factory=Faults)
    faulty: int = 1
    """Number of the muscle that bursts, or has the stuck regulator, valve or sensor."""
    errors: Mapping[str, SensorError] = field(default_factory=dict)
    """Errors of channel inputs, by input."""
    hoses: str = "straight"
    """`crossed`: on a joint each output moves the pressure of the other muscle."""
    built: Mapping[str, float] = field(default_factory=dict)
    """Dimensions of a joint or a platform [SI], by the names of a bench file; assumed if left out."""
    overrides: Overrides = field(default_factory=Overrides)
    """Given among the options by their own names, as `service`."""
    service: Service = field(default_factory=Service)


def _read(device: DeviceRecord, reader: Reader, *, realtime: bool) -> Options:
    own = set(_names(Options)) - {"numbers", "overrides", "service"}
    served = _names(Service) if realtime else []
    given = reader.keys(device.options, HERE, (*own, *_names(Overrides), *served))
    numbers = given["plant"] if isinstance(given.get("plant"), Mapping) else None
    plant = str(given.get("plant", Options.plant)) if numbers is None else str(numbers["file"])
    built = reader.named(given.get("built", {}), (*HERE, "built"))
    for name in built:
        reader.known((*HERE, "built", name), f"the plant {plant} has nothing called", name, BUILT_OF.get(plant, ()))
    faults = reader.keys(given.get("faults", {}), (*HERE, "faults"), _names(Faults))
    plain = own - {"faults", "built", "errors"} - ({"plant"} if numbers is not None else set())
    options = Options(
        **_values(reader, given, HERE, plain),
        **({} if numbers is None else {"plant": plant, "numbers": numbers}),
        faults=Faults(**_values(reader, faults, (*HERE, "faults"), _names(Faults))),
        errors=sensor_errors(reader, given.get("errors", {}), (*HERE, "errors")),
        built=_values(reader, built, (*HERE, "built"), BUILT_OF.get(plant, ())),
        overrides=Overrides(**_values(reader, given, HERE, _names(Overrides))),
        service=Service(**_values(reader, given, HERE, served)),
    )
    _check_plant(reader, options, [name for name in given if name in _names(Overrides)])
    if options.dump_lag < 0:
        reader.fault((*HERE, "dump_lag"), "a lag of at least 0 s is expected")
    for name, value in (("slow_vent", options.slow_vent), ("idle", options.service.idle)):
        if not value > 0:
            reader.fault((*HERE, name), f"a value above 0 is expected, not {value:g}")
    _check_names(device, reader, options)
    return options


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device of the driver `mock`."""
    options = _read(device, reader, realtime=False)
    if (options.faults.dead_at, options.faults.mute_at) != (None, None):
        reader.fault((*HERE, "faults"), "the faults dead_at and mute_at need the driver mock-realtime")
    return options


def read_realtime(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device of the driver `mock-realtime`."""
    options = _read(device, reader, realtime=True)
    if options.plant == PLATFORM:
        reader.fault((*HERE, "plant"), "a platform is simulated in virtual time only: driver mock")
    return options


def sensor_errors(reader: Reader, given: Any, place: Place) -> dict[str, SensorError]:
    """Errors of channel inputs, by input."""
    found, known = {}, _names(SensorError)
    for name, item in reader.named(given, place).items():
        if reader.known((*place, name), "no input", name, INPUTS):
            error = reader.keys(item, (*place, name), known)
            found[name] = SensorError(**_values(reader, error, (*place, name), known))
    return found


def _values(reader: Reader, given: Mapping[str, Any], place: Place, known: Collection[str]) -> dict[str, Any]:
    """What can be read of the known names, in the order given."""
    found = {name: _value(reader, given, name, place) for name in given if name in known}
    return {name: value for name, value in found.items() if value is not None}


def _value(reader: Reader, given: Mapping[str, Any], name: str, place: Place) -> Any:
    if name in CHOICES:
        return reader.choice(given, name, place, CHOICES[name], "") or None
    if name in TEXTS:
        return reader.text(given, name, place)
    if name == "start":
        return reader.flag(given, name, place, default=True)
    number = reader.number(given, name, place, "a number in SI")
    return int(number) if number is not None and name in WHOLE else number


def _check_plant(reader: Reader, options: Options, overrides: Sequence[str]) -> None:
    law = options.plant if options.numbers is None else str(options.numbers["law"])
    driven = options.free_end == "actuator"
    if law == "daerden" and not driven:
        reader.fault((*HERE, "plant"), f"{options.plant} is for a driven free end; write free_end: actuator, too")
    if law == "contractor" and not driven and options.numbers is not None:
        length = float(options.numbers["length"])
        if not FREE_LENGTHS[0] <= length <= FREE_LENGTHS[1]:
            known = f"{1e3 * FREE_LENGTHS[0]:g} to {1e3 * FREE_LENGTHS[1]:g} mm"
            why = f"a contractor with a free end is known for lengths of {known}, not for {1e3 * length:g} mm"
            reader.fault((*HERE, "plant"), f"{why}; write free_end: actuator, or another length")
    count = MUSCLES_OF.get(law, options.faulty)
    if not 1 <= options.faulty <= count:
        reader.fault((*HERE, "faulty"), f"the plant {law} has the muscles 1 to {count}, not {options.faulty}")
    if law == PLATFORM and options.preset != "bench":
        why = "without noise an accelerometer at rest counts as frozen; write preset: bench"
        reader.fault((*HERE, "preset"), why)
    if "parallel" in overrides and not driven:
        reader.fault((*HERE, "parallel"), "is for a driven free end; write free_end: actuator, too")
    for name in overrides if law in MUSCLES_OF else ():
        reader.fault((*HERE, name), f"the plant {options.plant} has no use for it")


def _check_names(device: DeviceRecord, reader: Reader, options: Options) -> None:
    there: dict[str, Sequence[str]] = {
        "input": inputs_of(options.free_end, options.plant),
        "output": outputs_of(options.free_end, options.plant),
        "valve": VALVES_OF.get(options.plant, VALVES),
        "digital input": [E_STOP],
    }
    for what, place, name in names_in(device):
        reader.known(place, f"no {what}", name, there[what])


def _names(kind: Any) -> list[str]:
    return [item.name for item in fields(kind)]


def inputs_of(free_end: str, plant: str) -> list[str]:
    """Channel inputs available with this free end and this plant."""
    if plant == PLATFORM:
        return [*OF_THREE, *ACCELERATIONS, *TURNS, "supply"]
    if plant == JOINT:
        own = (*PRESSURES, *(f"{name}_set" for name in PRESSURES), ANGLE, TORQUE, "supply")
        return [*own, "angle_set"] if free_end == "actuator" else [*own]
    without = ([] if free_end == "actuator" else ["displacement_set"]) + ([] if plant == ARM else [ANGLE])
    return [name for name in (*OF_ONE, *([FLOW] if free_end == "actuator" else [])) if name not in without]


def outputs_of(free_end: str, plant: str) -> tuple[str, ...]:
    """Outputs available with this free end and this plant."""
    if plant == PLATFORM:
        return ()
    pressures, driven = (PRESSURES, ANGLE) if plant == JOINT else (("pressure",), "displacement")
    return (*pressures, driven) if free_end == "actuator" else pressures


def pressure_of(options: Options) -> str:
    """Channel input of the pressure that gets stuck."""
    return f"pressure_{options.faulty}" if options.plant in MUSCLES_OF else "pressure"


def output_of(device: DeviceRecord, name: str, *values: float) -> OutputRecord:
    """The output of this name; raises DeviceError if there is none, or one of `values` [device units] is not finite."""
    outputs = {output.output: output for output in device.outputs}
    if name not in outputs:
        raise DeviceError(device.name, f'no output "{name}"{did_you_mean(name, outputs)}')
    for value in values:
        if not math.isfinite(value):
            raise DeviceError(device.name, f"cannot be commanded to {value}", name)
    return outputs[name]


def fault_name(device: str, name: str) -> str:
    """The field of `Faults` for `burst` or `burst_at`."""
    known = _names(Faults)
    full = name if name.endswith("_at") else f"{name}_at"
    if full not in known:
        raise DeviceError(device, f'no fault "{name}"{did_you_mean(full, known)}')
    return full
