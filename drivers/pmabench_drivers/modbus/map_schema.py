"""The JSON Schema of register maps, for editors; made of the tables of `map_file`, which checks more."""

from __future__ import annotations

from typing import Any

from pmabench_drivers.modbus.map_file import HIGH, LOW, UPTIMES
from pmabench_drivers.modbus.registers import BIT_TABLES, FUNCTIONS, TABLES, TYPES

Schema = dict[str, Any]
NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,3})?"
WRITTEN = ("holding", "coil")


def _whole(low: int, high: int) -> Schema:
    numbers: Schema = {"type": "integer", "minimum": low, "maximum": high}
    return {"anyOf": [numbers, {"type": "string", "pattern": "^0[xX][0-9A-Fa-f]{1,16}$"}]}


def _number() -> Schema:
    return {"anyOf": [{"type": "number"}, {"type": "string", "pattern": "^0[xX][0-9A-Fa-f]{1,16}$"}]}


def _quantity(kind: str, example: str) -> Schema:
    return {
        "type": "string",
        "description": f"{kind} with its unit",
        "pattern": rf"^\s*{NUMBER}\s*[A-Za-zµ]+\s*$",
        "examples": [example],
    }


def _text() -> Schema:
    return {"type": "string", "maxLength": 400}


def _order(what: str) -> Schema:
    return {"enum": [HIGH, LOW], "description": what}


def _object(properties: Schema, required: tuple[str, ...] = ()) -> Schema:
    return {"type": "object", "additionalProperties": False, "properties": properties, "required": list(required)}


def _register(use: str) -> Schema:
    """A register among the `inputs`, the `outputs` or in the `identity`."""
    properties: Schema = {
        "table": {"enum": list(WRITTEN if use == "outputs" else TABLES), "default": "holding"},
        "address": {**_whole(0, 65535), "description": "from 0, as on the wire: 40001 in a manual is holding 0"},
        "type": {"enum": ["bit", *TYPES, *(["text"] if use == "identity" else [])], "default": "uint16"},
        "words": _order("order of the two registers of a 32-bit value"),
        "bytes": _order("order of the bytes in a register"),
    }
    if use != "outputs":
        properties["bit"] = {**_whole(0, 31), "description": "the bit that is meant; 0 is the lowest"}
    if use == "outputs":
        properties["read_back"] = {"type": "boolean", "default": True}
    if use == "identity":
        properties["length"] = {**_whole(1, 60), "description": "registers of a text"}
        properties["expect"] = {**_number(), "description": "what it must hold"}
    bits: Schema = {"properties": {"table": {"enum": list(BIT_TABLES)}}, "required": ["table"]}
    return {
        **_object(properties, ("address",)),
        "if": bits,
        "then": {"properties": {"type": {"const": "bit"}}},
        "else": {"properties": {"type": {"not": {"const": "bit"}}}},
    }


def map_schema() -> Schema:
    """The schema of a register map."""
    written, polled = {"$ref": "#/$defs/output"}, {"$ref": "#/$defs/input"}
    identity = {"anyOf": [_text(), {"$ref": "#/$defs/identity"}]}
    watchdog = _object(
        {
            "timeout": written,
            "resolution": _quantity("time of one count", "10 ms"),
            "trigger": written,
            "on": _number(),
            "off": _number(),
            "heartbeat": written,
        },
        ("timeout",),
    )
    properties: Schema = {
        "schema": {"const": "pmabench.registers/1"},
        "name": _text(),
        "source": _text(),
        "unit_id": {**_whole(0, 255), "default": 1},
        "words": _order("order of the two registers of 32-bit values"),
        "bytes": _order("order of the bytes in registers"),
        "timeout": _quantity("longest wait for an answer", "100 ms"),
        "slowest": _quantity("how long after a question the device may still answer; serial lines", "1 s"),
        "rate": _quantity("highest poll rate", "100 Hz"),
        "functions": {"type": "array", "minItems": 1, "items": {"enum": list(FUNCTIONS)}},
        "identity": _object(dict.fromkeys(("maker", "model", "serial", "firmware", "constant"), identity)),
        "inputs": {"type": "object", "additionalProperties": polled},
        "outputs": {"type": "object", "additionalProperties": written},
        "watchdog": watchdog,
        "uptime": {
            **polled,
            "description": "a number of 32 bits that only grows until the device restarts",
            "properties": {"type": {"enum": list(UPTIMES)}},
            "required": ["type"],
        },
    }
    return {
        "$defs": {"input": _register("inputs"), "output": _register("outputs"), "identity": _register("identity")},
        "title": "Register map",
        "description": "The registers of one kind of Modbus device.",
        **_object(properties),
        "anyOf": [{"required": ["inputs"]}, {"required": ["outputs"]}],
    }
