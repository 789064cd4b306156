"""Numbers in registers: word orders by hand, every value back again, and nothing that does not fit."""

import math
import struct

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pmabench_drivers.modbus.registers import Register, decode, decode_text, encode, spans

# 3.75e5 as an IEEE single is 0x48B71B00; written out by hand for the two orders in which makers put it.
GOLDEN = {False: [0x48B7, 0x1B00], True: [0x1B00, 0x48B7]}


@pytest.mark.parametrize("low_word", GOLDEN)
def test_a_float_in_both_orders_of_words(low_word):
    register = Register("p", "holding", 0, "float32", low_word)
    assert encode(register, 375000.0) == GOLDEN[low_word]
    assert decode(register, GOLDEN[low_word]) == 375000.0


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        ("int16", -1, [0xFFFF]),
        ("uint16", 65535, [0xFFFF]),
        ("int16", -32768, [0x8000]),
        ("int32", -2, [0xFFFF, 0xFFFE]),
        ("uint32", 0x00112233, [0x0011, 0x2233]),
        ("float32", -9999.0, [0xC61C, 0x3C00]),
    ],
)
def test_known_words(kind, value, words):
    register = Register("p", "holding", 0, kind)
    assert encode(register, value) == words
    assert decode(register, words) == value


def by_hand(kind, words, low_word):
    """An independent decoder: every byte placed by its weight."""
    ordered = list(words[::-1] if low_word else words)
    bits = 0
    for word in ordered:
        bits = bits * 65536 + word
    size = 16 * len(ordered)
    if kind == "float32":
        sign, exponent, fraction = bits >> 31, bits >> 23 & 0xFF, bits & 0x7FFFFF
        if exponent == 255:
            return math.nan if fraction else (-math.inf if sign else math.inf)
        value = fraction * 2.0**-149 if exponent == 0 else (1 + fraction * 2.0**-23) * 2.0 ** (exponent - 127)
        return -value if sign else value
    return bits - (1 << size) if kind.startswith("int") and bits >> size - 1 else bits


@settings(max_examples=500)
@given(
    st.sampled_from(["int16", "uint16", "int32", "uint32", "float32"]),
    st.lists(st.integers(0, 65535), min_size=2, max_size=2),
    st.booleans(),
)
@example("float32", [0x7FC0, 0], False)
@example("float32", [0, 1], False)
def test_any_words_decode_as_by_hand_and_go_back(kind, words, low_word):
    register = Register("p", "input", 0, kind, low_word)
    words = words[: register.count]
    value, wanted = decode(register, words), by_hand(kind, words, low_word)
    assert value == wanted or (math.isnan(value) and math.isnan(wanted))
    if math.isfinite(value):
        assert encode(register, value) == words


@settings(max_examples=500)
@given(st.floats(), st.sampled_from(["int16", "uint16", "int32", "uint32", "float32"]))
@example(math.nan, "float32")
@example(70000.0, "uint16")
@example(-5.0, "uint16")
@example(3.5e38, "float32")
def test_what_is_encoded_is_what_was_meant_or_an_error(value, kind):
    register = Register("p", "holding", 0, kind)
    try:
        words = encode(register, value)
    except ValueError:
        limits = {"int16": 15, "uint16": 16, "int32": 31, "uint32": 32}
        if math.isfinite(value) and kind != "float32":
            low = -(2 ** limits[kind]) if kind.startswith("int") else 0
            assert not low <= round(value) < 2 ** limits[kind]
        return
    assert all(0 <= word <= 65535 for word in words)
    if kind == "float32":
        assert decode(register, words) == struct.unpack("f", struct.pack("f", value))[0]
    else:
        assert abs(decode(register, words) - value) <= 0.5


def test_bits_of_a_status_register():
    flags = [Register("s", "input", 3, "uint16", bit=bit) for bit in range(16)]
    assert [decode(flag, [0b1000_0000_0000_0101]) for flag in flags] == [1, 0, 1, *[0] * 12, 1]


def test_text_ends_at_zero_and_holds_nothing_that_cannot_be_printed():
    assert decode_text([0x4143, 0x4D45, 0x1B5B, 0x2041, 0x0041]) == "ACME[ A"


def test_neighbours_are_read_together_and_nothing_else_is_touched():
    a, b = Register("a", "input", 0, "float32"), Register("b", "input", 2, "int16")
    c, d = Register("c", "input", 4, "int16"), Register("d", "holding", 3, "int16")
    found = spans([c, b, d, a])
    assert [(s.table, s.address, s.count) for s in found] == [("holding", 3, 1), ("input", 0, 3), ("input", 4, 1)]
    assert found[1].values([0x3FC0, 0, 0xFFFF]) == [1.5, -1.0]


def test_no_transaction_is_longer_than_the_specification_allows():
    many = [Register(str(i), "input", i) for i in range(400)]
    assert [s.count for s in spans(many)] == [125, 125, 125, 25]
    bits = [Register(str(i), "coil", i, "bit") for i in range(2001)]
    assert [s.count for s in spans(bits)] == [2000, 1]
