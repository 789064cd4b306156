"""Installed drivers, and their checks of the options that a bench file gives them, before anything is opened.

A driver may have a class method `check(device: DeviceRecord)` that yields (place, message) for every mistake. A place
starts at the device (`options` or `address`) or at the top of the bench file (`channels`, `outputs`, `interlocks`
by name). It must touch no device and import nothing heavy.
Another one, `fastest(device: DeviceRecord)`, may return its highest sample rate with these options [Hz], so that we
can warn of a protocol that asks for more; it is called only if the options are valid.

A text as option `map` names a YAML file next to the bench file; its content replaces the name. The same holds for the
text of a DBC file (messages of a CAN bus), named by the option `dbc`, and the numbers of a plant file, named by the
option `plant`.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, did_you_mean
from pmabench.base.system import registered
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import DeviceRecord, Follower, Inputs, Motion, Pulses, SetPoint, Stream, Switch, Watchdog
from pmabench.bench.plant import Plant, read_plant
from pmabench.files.document import Document, Location, document_text, read_document

EMULATOR_ONLY = "emulator only"
"""Verification of a driver without a class attribute `verified`."""
HARDWARE = "hardware"
"""Start of `verified` for a driver that was tried on a device: `hardware (who, date, firmware)`."""
MAP, DBC, PLANT = "map", "dbc", "plant"
FILES = {MAP: "registers/regulator.yaml", DBC: "sensors/load-cell.dbc", PLANT: "plants/my-muscle.yaml"}
"""Options that name a file -> an example."""
LONGEST = 2_000_000
"""Longest DBC file accepted [bytes]."""


@lru_cache(maxsize=1)
def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in registered("pmabench.drivers")}


def drivers() -> dict[str, str]:
    """Name of each driver -> `module:Class`."""
    return {name: point.value for name, point in _points().items()}


def driver_class(name: str) -> str:
    """`module:Class` of a driver by its name, or as given in that form; ValueError if unknown."""
    if re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", name):
        return name
    known = drivers()
    if name not in known:
        raise ValueError(f'no driver "{name}" is installed{did_you_mean(name, known)}')
    return known[name]


def driver_version(target: str) -> str:
    """Version of the package that installed the driver `module:Class`; empty without one."""
    found = next((point for point in _points().values() if point.value == target and point.dist is not None), None)
    return found.dist.version if found is not None and found.dist is not None else ""


def verified(driver: object) -> str:
    """How a driver class was verified: `hardware (who, date, firmware)`, or `emulator only`."""
    return str(getattr(driver, "verified", EMULATOR_ONLY))


def checked(c: Compilation, device: DeviceRecord) -> DeviceRecord:
    """The device with its files read into the options; adds a problem for everything its driver objects to."""
    at: Location = ("devices", device.name)
    options, map_document = _options_with_files(c, device)
    if any(options[name] is None for name in options if device.options[name] is not None):
        return device
    device = replace(device, options=options)
    try:
        driver = loaded(device.driver)
    except (ImportError, AttributeError) as error:
        todo = "; install its package, or name its folder in PYTHONPATH" if isinstance(error, ImportError) else ""
        c.fault((*at, "driver"), f'the driver "{device.driver}" cannot be loaded: {error}{todo}')
        return device
    drift = getattr(driver, "drift", device.drift)
    device = replace(device, verified=device.verified or verified(driver), drift=drift)
    if _lacks_a_capability(c, device, driver):
        return device
    check = getattr(driver, "check", None)
    wrong = list(check(device)) if check is not None else []
    for place, message in wrong:
        _add_problem(c, at, place, message, map_document)
    fastest = getattr(driver, "fastest", None)
    if fastest is None or wrong:
        return device
    source = map_document.where(("rate",)) if map_document is not None else c.place(*at, "options", "rate")
    return replace(device, fastest=fastest(device), fastest_from=source)


def loaded(target: str) -> type:
    """Driver class `module:Class`; raises ImportError or AttributeError."""
    module, _, name = target.partition(":")
    found: type = getattr(import_module(module), name)
    return found


def _options_with_files(c: Compilation, device: DeviceRecord) -> tuple[dict[str, Any], Document | None]:
    """Options with file names replaced by contents (None for an invalid file), and the map file if there is one."""
    options, at = dict(device.options), ("devices", device.name, "options")
    map_document: Document | None = None
    for key in FILES:
        if isinstance(name := options.get(key), str) and (key != PLANT or name.endswith(".yaml")):
            found = options[key] = _read_file(c, name, key, (*at, key))
            if isinstance(found, Document):
                options[key], map_document = found.data, found
            elif isinstance(found, Plant):
                options[key] = {**found.numbers, "file": name}
                for sentence in found.beyond(device.outputs):
                    c.fault((*at, key), sentence)
        elif key == PLANT and isinstance(name, dict):
            c.fault((*at, key), "the name of a plant, or a plant file next to this one, is expected")
            options[key] = None
    return options, map_document


def _add_problem(c: Compilation, at: Location, place: Location, message: str, map_document: Document | None) -> None:
    """Add a driver's problem at its place: in the map file, at a channel, output or interlock, or at the device."""
    if map_document is not None and place[:2] == ("options", MAP):
        c.problems.append(map_document.problem(place[2:], message))
    elif place and place[0] in {"channels", "outputs"}:
        c.fault(place, message)
    elif place and place[0] == "interlocks":
        index = next(i for i, file in enumerate(c.bench.interlocks) if file.name == place[1])
        c.fault(("interlocks", index, "input", "input"), message)
    else:
        c.fault((*at, *place), message)


def _lacks_a_capability(c: Compilation, device: DeviceRecord, driver: type) -> bool:
    """Whether the bench file uses a capability that the driver lacks; adds a problem for each."""
    wants: list[tuple[Location, type, str]] = []
    wants += [(("channels", channel.name, "device"), Stream, "measures nothing") for channel in device.channels]
    wants += [(("outputs", output.name, "device"), SetPoint, "takes no set-points") for output in device.outputs]
    wants += [(("outputs", valve.name, "device"), Switch, "switches no valves") for valve in device.valves]
    pulsed, text = [valve.name for valve in device.valves if valve.longest], "opens no valve for a time that it keeps"
    wants += [(("outputs", name, "pulse"), Pulses, f"{text} by itself") for name in pulsed]
    for index, file in enumerate(c.bench.interlocks):
        if file.input.device == device.name:
            wants.append((("interlocks", index, "input", "device"), Inputs, "has no digital inputs"))
    if device.watchdog:
        wants.append((("devices", device.name, "watchdog"), Watchdog, "has no watchdog"))
    outputs = {output.name for output in device.outputs}
    for index, action in enumerate(c.bench.safe_state):
        if action.ramp_down in outputs:
            wants.append((("safe_state", index, "ramp_down"), Follower, "cannot follow a ramp by itself"))
        if action.drive_quick_stop in outputs:
            wants.append((("safe_state", index, "drive_quick_stop"), Motion, "cannot stop a motion by itself"))
    missing = [(place, text) for place, capability, text in wants if not issubclass(driver, capability)]
    for place, text in missing:
        c.fault(place, f'the driver "{c.bench.devices[device.name].driver}" {text}')
    return bool(missing)


def _read_file(c: Compilation, name: str, key: str, at: Location) -> Document | str | Plant | None:
    """The file that an option names, kept for the run's snapshot; None with a problem."""
    try:
        found = read_named_file(Path(c.bench_document.place(at)[0]).parent, name, key)
    except InvalidFile as error:
        c.problems.extend(problem for problem in error.problems if problem not in c.problems)
        return None
    except ValueError as error:
        c.fault(at, str(error))
        return None
    text = found if isinstance(found, str) else found.text if isinstance(found, Plant) else document_text(found)
    if name == "protocol.yaml" or c.texts.setdefault(name, text) != text:
        c.fault(at, f'in the record of a run another file is called "{name}"; give this one another name')
        return None
    return found


def read_named_file(folder: Path, name: str, key: str) -> Document | str | Plant:
    """The map, the text of the DBC file (Latin-1) or the plant that the option `key` of a file in `folder` names.

    Raises ValueError for a file that is elsewhere or cannot be read, InvalidFile for one that is no YAML.
    """
    path, suffix = Path(name), Path(FILES[key]).suffix
    if path.is_absolute() or ".." in path.parts or path.suffix.lower() != suffix:
        raise ValueError(f'a {suffix} file next to this one is expected, for instance "{FILES[key]}", not "{name}"')
    path = folder / path
    if key != DBC:
        return read_document(path) if key == MAP else read_plant(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(LONGEST + 1)
    except OSError as error:
        raise ValueError(f"cannot read {name}: {error.strerror}") from error
    if len(data) > LONGEST:
        raise ValueError(f"{name} is longer than {LONGEST} bytes")
    return data.decode("latin-1")
