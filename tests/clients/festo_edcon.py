"""festo-edcon in front of a CMMT: calls of its pages and examples that the driver makes as well.

Calls: the examples of https://github.com/Festo-se/festo-edcon (position, pnu_access, position_nonblock) and its page of
the MotionHandler, judged by what the client itself sees. Lengths are micrometres, velocities mm/s, as the
drive's parameters say. Only the port is changed in the client, which knows 502 alone.
"""

import contextlib
import functools
import logging
import os
import signal
import sys
import time

from edcon.edrive import com_modbus
from edcon.edrive.com_modbus import ComModbus
from edcon.edrive.motion_handler import MotionHandler
from said import call, not_tried

HOST, PORT = sys.argv[1].rsplit(":", 1)
LONGEST = 12
"""A step that takes longer blocks [s]: most of the client's wait for ever."""
CLOSE = 60
"""Positions agree to so much [um]: the muscle pulls a little at the drive."""
TELEGRAM, TARGET, SERIAL, POSITION_PREFIX, VELOCITY_PREFIX = 3490, 34, 2076, 11724, 11725


def blocks(_signal, _frame):
    raise TimeoutError(f"does not return within {LONGEST} s")


@contextlib.contextmanager
def soon():
    """What is in the block returns in time."""
    signal.alarm(LONGEST)
    yield
    signal.alarm(0)


def at(mot, position, saw):
    """The drive says that it stands there, and so it is seen."""
    now = mot.current_position()
    assert abs(now - position) <= CLOSE, f"stands at {now} and not at {position}"
    saw["displacement"] = 1e-6 * now


def wait(condition, what):
    until = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < until, f"no {what} within 5 s"
        time.sleep(0.02)


def ready(drive):
    assert drive.acknowledge_faults(), "keeps a fault"
    assert drive.enable_powerstage(), "is not enabled"
    return drive


signal.signal(signal.SIGALRM, blocks)
logging.disable(logging.CRITICAL)
com_modbus.ModbusClient = functools.partial(com_modbus.ModbusClient, port=int(PORT))
com = ComModbus(HOST)

with call("ComModbus"), soon():
    assert com.connected()
    assert com.device_info["vendor_name"]
    assert com.device_info["product_name"]

with call("set_timeout"), soon():
    assert com.set_timeout(800), "does not hold the time-out"

with call("read_pnu"), soon():
    assert com.read_pnu(TELEGRAM, 0) == 111
    found = {pnu: com.read_pnu(pnu) for pnu in (TARGET, SERIAL, POSITION_PREFIX, VELOCITY_PREFIX)}
    assert None not in found.values(), f"does not tell all of {found}"

with call("MotionHandler"), soon():
    mot = MotionHandler(com, config_mode="validate")

with call("acknowledge_faults"), soon():
    assert mot.acknowledge_faults(), "keeps a fault"
    assert mot.current_fault_code() == 0

with call("enable_powerstage"), soon():
    assert mot.enable_powerstage(), "is not enabled"
    assert mot.ready_for_motion()

with call("position_task(absolute=True)") as saw, soon():
    assert mot.position_task(10_000, 20, absolute=True)
    at(mot, 10_000, saw)

with call("position_task(nonblocking=True), target_position_reached") as saw, soon():
    assert mot.position_task(4_000, 20, absolute=True, nonblocking=True)
    time.sleep(0.1)
    assert not mot.target_position_reached(), "says at once that it is there"
    wait(mot.target_position_reached, "target")
    mot.stop_motion_task()
    at(mot, 4_000, saw)

with call("configure_continuous_update") as saw, soon():
    mot.configure_continuous_update(True)
    assert mot.position_task(8_000, 20, absolute=True, nonblocking=True)
    time.sleep(0.05)
    assert mot.position_task(6_000, 20, absolute=True, nonblocking=True)
    time.sleep(0.6)
    mot.stop_motion_task()
    mot.configure_continuous_update(False)
    at(mot, 6_000, saw)

with call("over_v") as saw, soon():
    mot.over_v = 50.0
    begun = time.monotonic()
    assert mot.position_task(20_000, 20, absolute=True)
    assert time.monotonic() - begun > 0.9, "10 mm took less than 0.9 s at half of 20 mm/s"
    mot.over_v = 100.0
    at(mot, 20_000, saw)

with call("a target outside of the stroke, current_fault_code"), soon():
    assert not mot.position_task(500_000, 20, absolute=True), "takes a target outside of its stroke"
    assert mot.current_fault_code() == 110
    ready(mot)

with call("disable_powerstage, shutdown"), soon():
    assert mot.disable_powerstage(), "keeps its power"
    mot.shutdown()

not_tried("homing, jogging, records, velocities, pauses, other telegrams", "the driver makes no such call")
os._exit(0)  # its threads do not end by themselves
