"""Options of the mock bench in a bench file; imports no large package, uses no plant."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import DeviceRecord, OutputRecord
from pmabench.model.overrides import Overrides

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
TEXT = {"plant", "preset", "free_end", "b_relax", "fce_eval", "reads", "end", "log", "hoses"}
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
    """Given among the options by their own names."""


@dataclass(frozen=True)
class Service:
    """Options of the plant's own process, for the driver `mock-realtime`; given among the others."""

    start: bool = True
    """Start the process if none listens at the device's address."""
    idle: float = 30.0
    """Time without a client after which it vents and ends [s]."""
    log: str = ""
    """File to which it appends the commands, as JSON lines; none by default."""
    clock_ppm: float = 0.0
    """Excess rate of the device's clock over bench time [ppm]."""
    clock_offset: float = 0.0
    """Time of the device's clock at bench time 0 [s]."""


def read_options(device: str, given: Mapping[str, Any]) -> Options:
    """Options checked by name and kind.

    Raises
    ------
    DeviceError
        For an unknown option, naming the most similar one, or an impossible value.
    """
    own = {*_names(Options)} - {"overrides", "numbers"}
    changes = _names(Overrides)
    values: dict[str, Any] = {}
    overrides: dict[str, Any] = {}
    for name, value in given.items():
        if name == "faults":
            values[name] = Faults(
                **_values(device, value, _names(Faults), "no fault", "faults are given as {name: time in s}")
            )
        elif name == "built":
            plant, shape = str(given.get("plant", "")), "built is given as {name: number in SI}"
            says = f"the plant {plant} has nothing called"
            values[name] = _values(device, value, BUILT_OF.get(plant, ()), says, shape)
        elif name == "errors":
            values[name] = _errors(device, value)
        elif name == "plant" and isinstance(value, Mapping):
            values.update(plant=str(value["file"]), numbers=value)
        elif name in own:
            values[name] = _value(device, name, value)
        elif name in changes:
            overrides[name] = _value(device, name, value)
        else:
            raise DeviceError(device, f'no option "{name}"{did_you_mean(name, [*own, *changes])}')
    options = Options(**values, overrides=Overrides(**overrides))
    _check_plant(device, options, overrides)
    if options.dump_lag < 0 or not options.slow_vent > 0:
        raise DeviceError(device, "option dump_lag needs a lag of at least 0 s, option slow_vent a factor above 0")
    return options


def _check_plant(device: str, options: Options, overrides: Mapping[str, Any]) -> None:
    law = options.plant if options.numbers is None else str(options.numbers["law"])
    if law == "daerden" and options.free_end != "actuator":
        way = "is for a driven free end; write free_end: actuator, too"
        raise DeviceError(device, f"option plant: {options.plant} {way}")
    if law == "contractor" and options.free_end == "weights" and options.numbers is not None:
        length = float(options.numbers["length"])
        if not FREE_LENGTHS[0] <= length <= FREE_LENGTHS[1]:
            known = f"{1e3 * FREE_LENGTHS[0]:g} to {1e3 * FREE_LENGTHS[1]:g} mm"
            why = f"a contractor with a free end is known for lengths of {known}, not for {1e3 * length:g} mm"
            raise DeviceError(device, f"option plant: {why}; write free_end: actuator, or another length")
    count = MUSCLES_OF.get(law, options.faulty)
    if not 1 <= options.faulty <= count:
        raise DeviceError(device, f"option faulty: the plant {law} has the muscles 1 to {count}, not {options.faulty}")
    if law == PLATFORM and options.preset != "bench":
        why = "without noise an accelerometer at rest counts as frozen; write preset: bench"
        raise DeviceError(device, f"option preset: {why}")
    if "parallel" in overrides and options.free_end != "actuator":
        raise DeviceError(device, "option parallel is for a driven free end; write free_end: actuator, too")
    if overrides and law in MUSCLES_OF:
        raise DeviceError(device, f"option {next(iter(overrides))}: the plant {options.plant} has no use for it")


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


def problems(device: DeviceRecord, own: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Errors of the plant's options `own` and of the names of inputs and outputs, each with its place."""
    free_end, plant = str(own.get("free_end", "weights")), str(own.get("plant", ""))
    try:
        read_options(device.name, own)
    except DeviceError as error:
        yield ("options",), error.message
    known, places = inputs_of(free_end, plant), outputs_of(free_end, plant)
    named: list[tuple[str, str, str, str, Sequence[str]]] = []
    named += [("channels", channel.name, "input", channel.input, known) for channel in device.channels]
    named += [("outputs", output.name, "output", output.output, places) for output in device.outputs]
    there_are = VALVES_OF.get(plant, VALVES)
    named += [("outputs", valve.name, "valve", valve.output, there_are) for valve in device.valves]
    named += [("interlocks", lock.name, "digital input", lock.input, (E_STOP,)) for lock in device.interlocks]
    for kind, of, what, name, there in named:
        if name not in there:
            hint = did_you_mean(name, there) or f"; there is {', '.join(there)}"
            yield (kind, of, "output" if kind == "outputs" else "input"), f'no {what} "{name}"{hint}'


def output_of(device: DeviceRecord, name: str, *values: float) -> OutputRecord:
    """The output of this name; raises DeviceError if there is none, or one of `values` [device units] is not finite."""
    outputs = {output.output: output for output in device.outputs}
    if name not in outputs:
        raise DeviceError(device.name, f'no output "{name}"{did_you_mean(name, outputs)}')
    for value in values:
        if not math.isfinite(value):
            raise DeviceError(device.name, f"cannot be commanded to {value}", name)
    return outputs[name]


def split_service(device: str, given: Mapping[str, Any]) -> tuple[Service, dict[str, Any]]:
    """The options of the process, checked, and all others unchanged."""
    names = _names(Service)
    start = given.get("start", True)
    if not isinstance(start, bool):
        raise DeviceError(device, f"option start: true or false is expected, not {start!r}")
    values = {name: _value(device, name, given[name]) for name in names if name in given and name != "start"}
    service = Service(start=start, **values)
    if not service.idle > 0:
        raise DeviceError(device, f"option idle: a time above 0 s is expected, not {service.idle:g}")
    return service, {name: value for name, value in given.items() if name not in names}


def fault_name(device: str, name: str) -> str:
    """The field of `Faults` for `burst` or `burst_at`."""
    known = _names(Faults)
    full = name if name.endswith("_at") else f"{name}_at"
    if full not in known:
        raise DeviceError(device, f'no fault "{name}"{did_you_mean(full, known)}')
    return full


def sensor_error(device: str, channel: str, given: Any) -> SensorError:
    """The error of one channel input, checked."""
    if channel not in INPUTS:
        raise DeviceError(device, f'errors: no input "{channel}"{did_you_mean(channel, INPUTS)}')
    shape = f"errors of {channel} are given as {{factor: ..., offset: ...}}"
    return SensorError(**_values(device, given, _names(SensorError), "no error", shape))


def _errors(device: str, given: Any) -> dict[str, SensorError]:
    items = _mapping(device, given, "errors are given as {input: {factor: ..., offset: ...}}")
    return {str(name): sensor_error(device, str(name), value) for name, value in items.items()}


def _values(device: str, given: Any, known: Collection[str], says: str, shape: str) -> dict[str, Any]:
    for name in _mapping(device, given, shape):
        if name not in known:
            raise DeviceError(device, f'{says} "{name}"{did_you_mean(str(name), known)}')
    return {name: _value(device, name, value) for name, value in given.items()}


def _mapping(device: str, given: Any, shape: str) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise DeviceError(device, f"{shape}, not {given!r}")
    return given


def _value(device: str, name: str, value: Any) -> Any:
    if name in TEXT:
        allowed = CHOICES.get(name)
        if not isinstance(value, str) or (allowed and value not in allowed):
            raise DeviceError(device, f'option {name}: "{value}"{did_you_mean(str(value), allowed or ())}')
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not value == value:
        raise DeviceError(device, f"option {name}: a number in SI is expected, not {value!r}")
    return int(value) if name in {"seed", "faulty"} else float(value)
