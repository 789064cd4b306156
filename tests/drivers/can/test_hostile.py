"""Frames that no node should send: no traceback, no hang, no sample that is none, nothing commanded."""

import math
import time

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.node import Objects

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Segment
from tests.drivers.can.rigs import CHANNELS, bus, channel, rig
from tests.drivers.can.test_dbc import LOAD_CELL
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime

KNOWN = [0x000, 0x080, 0x085, 0x08C, 0x185, 0x285, 0x18C, 0x585, 0x58C, 0x705, 0x70C, 0x77F, 800, 801]
frames = st.builds(
    Frame,
    st.sampled_from(KNOWN) | st.integers(0, 0x7FF),
    st.binary(max_size=8),
    st.booleans(),
)
answers = st.lists(
    st.binary(max_size=8)
    | st.builds(
        lambda head, rest: bytes([head]) + b"\x41\x60\x00" + rest,
        st.integers(0, 255),
        st.binary(min_size=4, max_size=4),
    ),
    max_size=6,
)


def test_frames_of_any_kind(record_property):
    """While samples are taken and a sine is under way; the nodes themselves go on."""
    count = cases(300)
    record_property("cases", count)
    signals = (
        channel("force", "force", "LoadCell.Force", unit="N"),
        channel("small", "pressure", "Floats.Small", unit="bar"),
    )
    with rig(bus(channels=(*CHANNELS, *signals), dbc=LOAD_CELL, watchdog=0.0)) as (emulator, served, driver):
        driver.start(100.0)
        driver.write("drive.position", 0.0)
        driver.follow(
            "drive.position", Segment("sine", driver._clock.now(), 0.0, amplitude=1000.0, frequency=1.0, cycles=1e6)
        )

        @settings(max_examples=count)
        @given(st.lists(frames, max_size=8))
        def feed(given_frames):
            for frame in given_frames:
                driver._take(frame, driver._clock.now())
            began = time.monotonic()
            try:
                block = driver.collect()
            except DeviceError as error:
                assert len(str(error)) < 500
            else:
                assert all(math.isfinite(value) for column in block.columns.values() for value in column)
            assert time.monotonic() - began < 1.0
            for node in driver._nodes.values():
                node._trouble = ""

        feed()
        assert driver._link.gone == ""
        moved = [entry["si"] for entry in emulator.log.of("move")]
        assert max(map(abs, moved)) <= 1.0011e-3  # the sine and nothing else
        driver.halt("drive.position")
        assert served.nodes["drive"].drive_state.value in {"quick stop active", "switch on disabled"}


def test_answers_of_any_kind(record_property):
    """To questions about one object: a number, or an error of ours within the time."""
    count = cases(300)
    record_property("cases", count)

    @settings(max_examples=count)
    @given(answers, st.booleans())
    def ask(given_answers, written):
        waiting = list(given_answers)

        def send(_identifier, _data):
            while waiting:
                objects.take(waiting.pop(0))

        objects = Objects("bus", "drive", 5, send)
        began = time.monotonic()
        try:
            if written:
                objects.write(0x6041, 0, "H", 1, began + 0.003)
            else:
                assert 0 <= objects.read(0x6041, 0, "H", began + 0.003) <= 0xFFFF
        except DeviceError as error:
            assert "drive" in str(error)
        assert time.monotonic() - began < 1.0

    ask()
