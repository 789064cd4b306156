"""`pmabench devices probe --driver`: who answers at an address, without a bench file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pmabench.base.errors import UsageError


def who_answers(driver: str, address: str, options: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Open a device by the name of its driver (or `module:Class`) and its address, ask who it is, and close.

    `options` are those of a bench file, as name=value. Raises UsageError where they cannot be read, DeviceError where
    the driver refuses them or nobody answers.
    """
    from pmabench.base.clock import RealClock
    from pmabench.bench.interface import DeviceRecord
    from pmabench.bench.registry import driver_class, verified
    from pmabench.engine.untried import doubt
    from pmabench.guard.links import OPENS_WITHIN, load_driver
    from pmabench.guard.owner import Owner

    try:
        target = driver_class(driver)
    except ValueError as error:
        raise UsageError(f"--driver: {error}; or give module:Class") from error
    record = DeviceRecord("device", target, address, dict(_option(text) for text in options))
    device = load_driver(record, RealClock())
    owner = Owner(record.name)
    try:
        identity = owner.call(device.open, OPENS_WITHIN)
    finally:
        owner.call(device.close, OPENS_WITHIN)
    record = DeviceRecord("device", target, address, verified=verified(type(device)))
    return {record.name: {**vars(identity), "verified": record.verified, "doubt": doubt(record, identity)}}


def _option(text: str) -> tuple[str, Any]:
    """`rate=50 Hz` as a bench file would give it."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    name, equals, value = text.partition("=")
    if not equals or not name:
        raise UsageError(f'--option: "{text}" is not name=value, for instance rate=50 Hz')
    try:
        return name, YAML(typ="safe", pure=True).load(value)
    except YAMLError as error:
        raise UsageError(f'--option {name}: "{value}" cannot be read as in a bench file') from error
