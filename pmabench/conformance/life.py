"""Check of opening and closing a device."""

from __future__ import annotations

from functools import partial
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import EMULATED, Block, Identity, Supervised
from pmabench.conformance.relay import Relay
from pmabench.conformance.rig import COLLECTS_WITHIN, Rig
from pmabench.conformance.verdict import Failed


def life(rig: Rig) -> str:
    """It opens, says who answers, closes (twice), opens again; closed, its calls say so."""
    before = len(_commanded(rig))
    with rig.opened(armed=False) as device:
        if commanded := _commanded(rig)[before:]:
            raise Failed(f"open() commands something: {commanded[0]}; it connects and identifies, nothing else")
        if not rig.identity.simulated and any(_says_emulated(relay) for relay in rig.relays):
            raise Failed(f'the device says "{EMULATED.strip()}" over its wire, and open() gives simulated=False')
        rig.call("close()", device.close).good(COLLECTS_WITHIN)
        rig.call("close() again", device.close).good(COLLECTS_WITHIN)
        for what, act in _questions(rig, device):
            answer = rig.call(f"{what} after close()", act).judged(COLLECTS_WITHIN)
            if not isinstance(answer, DeviceError) and not (isinstance(answer, Block) and not len(answer.time)):
                raise Failed(f"{what} after close() gave {answer!r}; a DeviceError is expected")
        again = rig.call("open() again", device.open).good(rig.opens_within)
        if not isinstance(again, Identity):
            raise Failed("a driver that was closed cannot be opened again")
    who = f"{again.maker} {again.model}".strip()
    return who if again.simulated else f"{who}; its wire does not show that it is emulated"


def _says_emulated(relay: Relay) -> bool:
    return EMULATED.encode() in b"".join(data for sent, data in relay.heard if sent)


def _commanded(rig: Rig) -> list[Any]:
    """What the emulated device was commanded so far."""
    return [entry for kind in ("set", "switch", "move", "halt") for entry in rig.logged(kind)]


def _questions(rig: Rig, device: Any) -> list[tuple[str, Any]]:
    """What can be asked of the device without changing anything."""
    asked: list[tuple[str, Any]] = []
    asked += [("read_back()", partial(device.read_back, output.output)) for output in rig.record.outputs]
    asked += [("is_on()", partial(device.is_on, valve.output)) for valve in rig.record.valves]
    asked += [("level()", partial(device.level, lock.input)) for lock in rig.record.interlocks]
    asked += [("held()", device.held)] if isinstance(device, Supervised) else []
    asked += [("collect()", device.collect)] if rig.streams() else []
    return asked
