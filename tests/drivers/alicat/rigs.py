"""A controller as a record, its driver and its emulator, and a peer on a pseudo-terminal that answers by hand."""

import os
import select
import threading
import tty
from dataclasses import replace

from pmabench.bench.interface import ChannelRecord, DeviceRecord, OutputRecord, Scale

DRIVER = "pmabench_drivers.alicat:AlicatController"
PASCAL = {"kPa": 1e3, "bar": 1e5, "psi": 6894.757293168, "hPa": 100.0, "mbar": 100.0, "MPa": 1e6, "Pa": 1.0}


def controller(address, protocol="ascii", unit="kPa", **options):
    """A controller with pressure, set-point and output in one unit; at 115200 baud where nothing else is said."""
    scale, given = Scale(PASCAL[unit]), {"protocol": protocol, "baud": 115200, **options}
    if protocol == "modbus":
        given.setdefault("unit", unit)
    return DeviceRecord(
        "controller",
        DRIVER,
        str(address),
        given,
        tuple(
            ChannelRecord(name, "pressure", "controller", source, "float64", unit, scale, -50e3, 1e6)
            for name, source in (("pressure", "pressure"), ("pressure_command", "set_point"))
        ),
        (OutputRecord("pressure", "pressure", "controller", "pressure", scale, 0.01, 0.0, 0.0, 6e5),),
    )


class HandPeer:
    """A far end of a pseudo-terminal whose answer to each question (a line without its end) is `reply(question)`."""

    def __init__(self, path, reply):
        self.reply, self.questions = reply, []
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        path.symlink_to(os.ttyname(self._far))
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._ended = threading.Event()
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join(5)
        os.close(self._near)
        os.close(self._far)

    def _serve(self):
        data = b""
        while not self._ended.is_set():
            if not select.select([self._near], [], [], 0.02)[0]:
                continue
            data += os.read(self._near, 4096)
            while b"\r" in data:
                line, data = data.split(b"\r", 1)
                self.questions.append(line.decode())
                os.write(self._near, self.reply(line.decode()))


def listing(*rows, head="A D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________"):
    """A list of columns: rows of (statistic, name, type, width, notes)."""
    return [
        head.encode(),
        *(
            f"A D{number:02d} {code} {name:<26} {kind:<11} {width:>5} {notes}".rstrip().encode()
            for number, (code, name, kind, width, notes) in enumerate(rows, 1)
        ),
    ]


__all__ = ["DRIVER", "HandPeer", "controller", "listing", "replace"]
