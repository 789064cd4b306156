"""A driver's options as strictly read plain data: every problem with its place; uses no driver. Standard library only.

`check`, which reports all problems, and the driver itself, which raises the first one, use the same functions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, fields
from ipaddress import ip_address
from typing import Any, Concatenate, ParamSpec, TypeVar

from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import DeviceRecord

T = TypeVar("T")
P = ParamSpec("P")
Place = tuple[str | int, ...]
"""Keys from the top of the bench file (`("channels", "pressure", "input")`) or of the device (`("options", "map")`)."""

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
    "speed": {"m/s": 1.0, "mm/s": 1e-3},
}
BAUDS = (1200, 2400, 4800, 9600, 14400, 19200, 38400, 57600, 76800, 115200, 230400, 460800, 921600)
PARITIES = {"none": "N", "even": "E", "odd": "O"}
_QUANTITY = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*([A-Za-z/]+)")
_EXAMPLES = {"time": '"100 ms"', "frequency": '"50 Hz"', "speed": '"20 mm/s"'}


class Reader:
    """Reads values and collects their problems; a wrong value is replaced by its default."""

    def __init__(self) -> None:
        self.problems: list[tuple[Place, str]] = []

    def fault(self, place: Place, message: str) -> None:
        """Note a problem."""
        self.problems.append((place, message))

    def options(
        self, kind: type[T], value: Any, place: Place, more: Collection[str] = (), needed: Collection[str] = ()
    ) -> tuple[T, Mapping[str, Any]]:
        """A record of `kind` with its fields made by `option`, and the mapping; `more`: keys that the caller reads."""
        declared = {item.name: item.metadata["read"] for item in fields(kind) if "read" in item.metadata}  # type: ignore[arg-type]
        given = self.keys(value, place, (*declared, *more), needed)
        return kind(**{name: read(self, given, name, place) for name, read in declared.items()}), given

    def keys(self, value: Any, place: Place, known: Collection[str], needed: Collection[str] = ()) -> Mapping[str, Any]:
        """A mapping with known keys only, and with all needed ones."""
        if not isinstance(value, Mapping):
            self.fault(place, f"keys and values are expected here, not {_shown(value)}")
            return {}
        for key in value:
            if key not in known:
                self.fault((*place, key), f'unknown key "{key}"{did_you_mean(str(key), known)}')
        for key in needed:
            if key not in value:
                self.fault(place, f'"{key}" is missing')
        return value

    def named(self, value: Any, place: Place) -> Mapping[str, Any]:
        """A mapping with names chosen by the user."""
        if not isinstance(value, Mapping):
            self.fault(place, f"names and what belongs to them are expected here, not {_shown(value)}")
            return {}
        return value

    def text(self, given: Mapping[str, Any], key: str, place: Place, default: str = "", longest: int = 200) -> str:
        """A text."""
        value = given.get(key, default)
        if not isinstance(value, str) or len(value) > longest:
            self.fault((*place, key), f"a text of at most {longest} characters is expected, not {_shown(value)}")
            return default
        return value

    def texts(self, given: Mapping[str, Any], key: str, place: Place, default: tuple[str, ...] = ()) -> tuple[str, ...]:
        """A list of texts."""
        value = given.get(key, default)
        if not isinstance(value, list | tuple) or not all(isinstance(item, str) and item for item in value):
            self.fault((*place, key), f"a list of texts is expected, not {_shown(value)}")
            return ()
        return tuple(value)

    def choice(self, given: Mapping[str, Any], key: str, place: Place, known: Iterable[str], default: str) -> str:
        """One of the known words."""
        value, options = given.get(key, default), tuple(known)
        if value not in options:
            self.fault((*place, key), f"{_shown(value)} is not known here{did_you_mean(str(value), options)}")
            return default
        return str(value)

    def mapped(self, given: Mapping[str, Any], key: str, place: Place, known: Mapping[str, T], default: str) -> T:
        """What belongs to one of the known words."""
        return known[self.choice(given, key, place, known, default)]

    def choices(self, given: Mapping[str, Any], key: str, place: Place, known: Iterable[str]) -> dict[str, str]:
        """One of the known words for each name chosen by the user; a wrong one is replaced by the first."""
        items, options = self.named(given.get(key, {}), (*place, key)), tuple(known)
        return {name: self.choice(items, name, (*place, key), options, options[0]) for name in items}

    def flag(self, given: Mapping[str, Any], key: str, place: Place, *, default: bool) -> bool:
        """True or false."""
        value = given.get(key, default)
        if not isinstance(value, bool):
            self.fault((*place, key), f"true or false is expected, not {_shown(value)}")
            return default
        return value

    def whole(
        self, given: Mapping[str, Any], key: str, place: Place, low: int, high: int, default: int | None = None
    ) -> int:
        """An integer from `low` to `high`; also as `"0x1F"`."""
        value = _unhexed(given.get(key, default))
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            if key in given or default is None:
                self.fault((*place, key), f"a whole number from {low} to {high} is expected, not {_shown(value)}")
            return low if default is None else default
        return value

    def one_of(self, given: Mapping[str, Any], key: str, place: Place, known: Sequence[int], default: int) -> int:
        """One of the known integers, which are in increasing order."""
        if (value := self.whole(given, key, place, known[0], known[-1], default)) not in known:
            self.fault((*place, key), f"{value} is not possible here; known: {', '.join(map(str, known))}")
        return value

    def known(self, place: Place, says: str, name: str, known: Iterable[str], more: str = "") -> bool:
        """Whether a name is known; if not, notes a problem that begins with `says` and ends with `more`."""
        if name in (names := list(known)):
            return True
        self.fault(place, f'{says} "{name}"{did_you_mean(str(name), names)}{more}')
        return False

    def lines(self, device: DeviceRecord, numbers: Mapping[str, int], more: str) -> None:
        """Check that valves and interlocks each have their own digital line; `numbers` are those of all names."""
        seen: dict[int, str] = {}
        for kind, place, name in names_in(device):
            if kind in ("valve", "digital input") and self.known(place, "no digital line", name, numbers, more):
                if numbers[name] in seen:
                    self.fault(place, f"{name} is in use by {seen[numbers[name]]}")
                seen.setdefault(numbers[name], str(place[1]))

    def measures_only(self, device: DeviceRecord, who: str, unit: str = "") -> None:
        """Check that the bench commands nothing of the device, and that its channels have the device's `unit`."""
        if device.guarded:
            self.fault((), f"{who} only measures; it has no outputs, valves, interlocks or watchdog")
        for channel in device.channels:
            if unit and channel.raw_unit != unit:
                self.fault(("channels", channel.name), f'{who} gives {unit}, and the channel has "{channel.raw_unit}"')

    def port(self, device: DeviceRecord, example: str) -> None:
        """Check that the address is that of a serial port."""
        if not device.address:
            self.fault(("address",), f'the path of a serial port is expected, for instance "{example}"')

    def host(self, device: DeviceRecord, example: str, usual: int | None = None, other: str = "") -> tuple[str, int]:
        """Host and port of IP:PORT, or of IP alone if a `usual` port is given; `other`: further possibilities."""
        host, colon, port = device.address.rpartition(":")
        if not colon and usual is not None:
            host, port = device.address, str(usual)
        try:
            ip_address("127.0.0.1" if host == "localhost" else host.strip("[]"))
            if port.isdecimal() and int(port) <= 65535:
                return host, int(port)
        except ValueError:
            pass
        wanted = f'an IP address{"" if usual else " with a port"} ("{example}"){other}'
        self.fault(("address",), f'{wanted} is expected, not "{device.address}"')
        return "", 0

    def watchdog(self, device: DeviceRecord, who: str, shortest: float, longest: float) -> None:
        """Check that the device can have the bench's watchdog time [s]."""
        if device.watchdog and not shortest <= device.watchdog <= longest:
            self.fault(("watchdog",), f"{who} waits {shortest:g} to {longest:g} s, not {device.watchdog:g} s")

    def number(self, given: Mapping[str, Any], key: str, place: Place, what: str = "a number") -> float | None:
        """A finite number, also as `"0x1F"`; None if there is none."""
        value = _unhexed(given.get(key))
        if value is None or (isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)):
            return None if value is None else float(value)
        self.fault((*place, key), f"{what} is expected, not {_shown(value)}")
        return None

    def quantity(
        self, given: Mapping[str, Any], key: str, place: Place, kind: str, default: float, low: float, high: float
    ) -> float:
        """A time [s], a frequency [Hz] or a speed [m/s] as NUMBER UNIT, from `low` to `high`."""
        if key not in given:
            return default
        value = given[key]
        match = _QUANTITY.fullmatch(value.strip()) if isinstance(value, str) else None
        factor = UNITS[kind].get(match[2]) if match else None
        if match is None or factor is None:
            self.fault((*place, key), f"a {kind} with its unit is expected, for instance {_EXAMPLES[kind]}")
            return default
        number = float(match[1]) * factor
        if not low <= number <= high:
            self.fault((*place, key), f"{value} is outside {low:g} to {high:g} {next(iter(UNITS[kind]))}")
            return default
        return number


def names_in(device: DeviceRecord) -> Iterator[tuple[str, Place, str]]:
    """What a bench uses of a device: `input`, `output`, `valve` or `digital input`, its place and its name."""
    for kind, group, key, records in (
        ("input", "channels", "input", device.channels),
        ("output", "outputs", "output", device.outputs),
        ("valve", "outputs", "output", device.valves),
        ("digital input", "interlocks", "input", device.interlocks),
    ):
        for record in records:
            yield kind, (group, record.name, key), getattr(record, key)


def option(
    read: Callable[Concatenate[Reader, Mapping[str, Any], str, Place, P], T], *args: P.args, **kwargs: P.kwargs
) -> T:
    """A field of a record of options: its key is read by `read`, for instance `Reader.quantity`, with these arguments.

    Its default is what `read` gives where the key is missing.
    """

    def read_key(reader: Reader, given: Mapping[str, Any], key: str, place: Place) -> T:
        return read(reader, given, key, place, *args, **kwargs)

    made: T = field(default_factory=lambda: read_key(Reader(), {}, "", ()), metadata={"read": read_key})
    return made


def options_of(device: DeviceRecord, read: Callable[[DeviceRecord, Reader], T]) -> T:
    """The options of a device as read by `read`; raises the first problem as a `DeviceError`."""
    reader = Reader()
    options = read(device, reader)
    for place, message in reader.problems:
        raise DeviceError(device.name, f"{'.'.join(map(str, place))}: {message}")
    return options


def _unhexed(value: Any) -> Any:
    """A number written as `"0x1F"`; anything else unchanged."""
    hexadecimal = isinstance(value, str) and re.fullmatch(r"0[xX][0-9A-Fa-f]{1,16}", value)
    return int(value, 16) if hexadecimal else value


def _shown(value: Any) -> str:
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
