"""Checks by a driver of the options that a bench file gives it, before anything is opened.

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

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import DeviceRecord, Follower, Inputs, Motion, Pulses, SetPoint, Stream, Switch, Watchdog
from pmabench.bench.plant import read_plant
from pmabench.bench.registry import verified
from pmabench.files.document import Document, Location, document_text, read_document

MAP, DBC, PLANT = "map", "dbc", "plant"
LONGEST = 2_000_000
"""Longest DBC file accepted [bytes]."""


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
    if isinstance(options.get(MAP), str):
        map_document = _read_map(c, options[MAP], (*at, MAP))
        options[MAP] = None if map_document is None else map_document.data
    if isinstance(options.get(DBC), str):
        options[DBC] = _read_dbc(c, options[DBC], (*at, DBC))
    if isinstance(options.get(PLANT), dict) or str(options.get(PLANT)).endswith(".yaml"):
        options[PLANT] = _read_plant(c, device, (*at, PLANT))
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


def _read_dbc(c: Compilation, name: str, at: Location) -> str | None:
    """Text of a DBC file (Latin-1), kept for the run's snapshot; None with a problem."""
    path = Path(name)
    if path.is_absolute() or ".." in path.parts or path.suffix.lower() != ".dbc":
        c.fault(at, f'a .dbc file next to this one is expected, for instance "sensors/load-cell.dbc", not "{name}"')
        return None
    try:
        with (Path(c.bench_document.place(at)[0]).parent / path).open("rb") as stream:
            data = stream.read(LONGEST + 1)
    except OSError as error:
        c.fault(at, f"cannot read {name}: {error.strerror}")
        return None
    if len(data) > LONGEST:
        c.fault(at, f"{name} is longer than {LONGEST} bytes")
        return None
    text = data.decode("latin-1")
    return text if _keep(c, name, text, at) else None


def _read_plant(c: Compilation, device: DeviceRecord, at: Location) -> dict[str, Any] | None:
    """Numbers of a plant file, kept for the run's snapshot; None with a problem."""
    name = device.options[PLANT]
    if not isinstance(name, str):
        c.fault(at, "the name of a plant, or a plant file next to this one, is expected")
        return None
    if (path := _yaml_path(c, name, at, "plants/my-muscle.yaml")) is None:
        return None
    try:
        plant = read_plant(path)
    except InvalidFile as error:
        c.problems.extend(problem for problem in error.problems if problem not in c.problems)
        return None
    for sentence in plant.beyond(device.outputs):
        c.fault(at, sentence)
    return None if not _keep(c, name, plant.text, at) else {**plant.numbers, "file": name}


def _yaml_path(c: Compilation, name: str, at: Location, example: str) -> Path | None:
    """Path of a .yaml file next to the file that names it at `at`; None with a problem."""
    path = Path(name)
    if path.is_absolute() or ".." in path.parts or path.suffix != ".yaml":
        c.fault(at, f'a .yaml file next to this one is expected, for instance "{example}", not "{name}"')
        return None
    return Path(c.bench_document.place(at)[0]).parent / path


def _keep(c: Compilation, name: str, text: str, at: Location) -> bool:
    """Keep the text for the run's snapshot; False, with a problem, if another file already has this name."""
    if name == "protocol.yaml" or c.texts.setdefault(name, text) != text:
        c.fault(at, f'in the record of a run another file is called "{name}"; give this one another name')
        return False
    return True


def _read_map(c: Compilation, name: str, at: Location) -> Document | None:
    """Map file, kept for the run's snapshot; None with a problem."""
    if (path := _yaml_path(c, name, at, "registers/regulator.yaml")) is None:
        return None
    try:
        document = read_document(path)
    except InvalidFile as error:
        c.problems.extend(problem for problem in error.problems if problem not in c.problems)
        return None
    return document if _keep(c, name, document_text(document), at) else None
