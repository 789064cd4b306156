"""Drivers that nobody has tried on hardware: the operator is asked once for each bench, and the run records it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pmabench.base.errors import PmaError
from pmabench.bench.interface import UNPROVEN, CompiledBench, DeviceRecord, Identity
from pmabench.bench.registry import HARDWARE, driver_version
from pmabench.engine.executor import Executor
from pmabench.guard.station import Station

FILE = "drivers"
"""In the bench's state folder: the drivers that somebody agreed to, by driver and version."""
PHASE = "driver"


def as_data(bench: CompiledBench) -> dict[str, dict[str, str]]:
    """For the manifest: each device's driver, its version and what it was verified on."""
    return {
        device.name: {
            "driver": device.driver,
            "version": driver_version(device.driver),
            "verified": device.verified,
        }
        for device in bench.devices
    }


def doubt(device: DeviceRecord, identity: Identity) -> str:
    """Why the driver of a device that answers as hardware is not verified for it; empty where it is, or simulated."""
    if identity.simulated:
        return ""
    if not device.verified.startswith(HARDWARE):
        return f"was never tried on a device (verified: {device.verified})"
    if device.verified_firmware and device.verified_firmware != identity.firmware:
        return f"is {device.verified}, and firmware {identity.firmware or 'unknown'} answers"
    return ""


def not_proven(identities: Mapping[str, Identity]) -> list[str]:
    """The emulated devices whose wiring and scales were taken from the bench file, so that its errors cancel out."""
    return [name for name, identity in identities.items() if identity.model.startswith(UNPROVEN)]


def agree(executor: Executor, identities: Mapping[str, Identity]) -> None:
    """Ask once per bench, driver, version and doubt, with nothing armed yet; a person's answer is remembered."""
    station = Station(executor.bench.name)
    for device in executor.bench.devices:
        identity = identities[device.name]
        why = doubt(device, identity)
        if not why:
            continue
        key = f"{device.driver} {driver_version(device.driver)} {why}"
        agreed = station.read(FILE)
        if key not in agreed:
            answer = _ask(executor, device, identity, why)
            if "--yes" not in answer:
                at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
                with suppress(PmaError):  # it is asked again then
                    station.write(FILE, {**agreed, key: {"answer": answer, "at": at}})


def _ask(executor: Executor, device: DeviceRecord, identity: Identity, why: str) -> str:
    who = " ".join(part for part in (identity.maker, identity.model) if part)
    text = (
        f"The driver of {device.name} ({who}), {device.driver}, {why}. Trust no value and no vent before you have "
        "compared it with an instrument. This is asked once."
    )
    acquisition, clock = executor.acquisition, executor.clock

    def wait() -> None:
        acquisition.pass_time(0.1)

    about: dict[str, Any] = {"text": text, "phase": PHASE, "device": device.name}
    executor.recorder.event("prompt", clock.now(), **about)
    answer = executor.operator.ask(text, acquisition.latest, wait)
    executor.recorder.event("answer", clock.now(), **about, answer=answer)
    return answer
