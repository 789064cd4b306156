"""festo-edcon in front of a CMMT: the calls of its pages and examples, judged by what the client itself sees.

Calls: the examples of https://github.com/Festo-se/festo-edcon (position, velocity, jog, record, pnu_access, *_nonblock,
fix_stop), its pages of the MotionHandler and of the command line. Lengths are micrometres, velocities mm/s, as the
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
from edcon.edrive.telegram1_handler import Telegram1Handler
from edcon.edrive.telegram9_handler import Telegram9Handler
from edcon.edrive.telegram102_handler import Telegram102Handler
from said import call, not_tried

HOST, PORT = sys.argv[1].rsplit(":", 1)
LONGEST = 12
"""A step that takes longer blocks [s]: most of the client's wait for ever."""
CLOSE = 60
"""Positions agree to so much [um]: the muscle pulls a little at the drive."""
TELEGRAM, STATUS, TARGET, FAULT, SERIAL, BASE = 3490, 2, 34, 301, 2076, 12345


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


def opened(handler):
    return handler(ComModbus(HOST), config_mode="write")


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

with call("read_pnu, write_pnu: telegram selection"), soon():
    before = com.read_pnu(TELEGRAM, 0)
    assert before == 111
    assert com.write_pnu(TELEGRAM, 0, 1), "refuses telegram 1"
    assert com.read_pnu(TELEGRAM, 0) == 1
    assert com.write_pnu(TELEGRAM, 0, before), "refuses telegram 111"
    assert not com.write_pnu(TELEGRAM, 0, 7), "takes telegram 7, which no such drive has"

with call("read_pnu: others"), soon():
    found = {pnu: com.read_pnu(pnu) for pnu in (STATUS, TARGET, FAULT, SERIAL, BASE)}
    assert None not in found.values(), f"does not tell all of {found}"

with call("MotionHandler"), soon():
    mot = MotionHandler(com, config_mode="write")
    mot.base_velocity = com.read_pnu(BASE)

with call("acknowledge_faults"), soon():
    assert mot.acknowledge_faults(), "keeps a fault"
    assert mot.current_fault_code() == 0

with call("enable_powerstage"), soon():
    assert mot.enable_powerstage(), "is not enabled"
    assert mot.ready_for_motion()

with call("referencing_task") as saw, soon():
    assert mot.referencing_task(), "homing is not acknowledged or does not end"
    assert mot.referenced()
    at(mot, 0, saw)

with call("position_task(absolute=True)") as saw, soon():
    assert mot.position_task(10_000, 20, absolute=True)
    at(mot, 10_000, saw)

with call("position_task") as saw, soon():  # relative, as where nothing is said
    assert mot.position_task(5_000, 20)
    at(mot, 15_000, saw)
    assert mot.position_task(-3_000, 20)
    at(mot, 12_000, saw)

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

with call("pause_motion_task, resume_motion_task") as saw, soon():
    assert mot.position_task(14_000, 10, absolute=True, nonblocking=True)
    time.sleep(0.2)
    mot.pause_motion_task()
    paused = mot.current_position()
    time.sleep(0.2)
    assert abs(mot.current_position() - paused) <= CLOSE, "goes on while it is paused"
    assert paused < 13_000, "was not stopped before its target"
    mot.resume_motion_task()
    time.sleep(1.5)
    at(mot, 14_000, saw)
    mot.stop_motion_task()

with call("velocity_task") as saw, soon():
    start = mot.current_position()
    assert mot.velocity_task(10, 0.5)
    forth = mot.current_position()
    assert 3_000 < forth - start < 20_000, f"went {forth - start} um in 0.5 s at 10 mm/s"
    assert mot.velocity_task(-10, 0.5)
    assert mot.current_position() < forth - 3_000
    at(mot, mot.current_position(), saw)

with call("current_velocity"), soon():
    assert mot.velocity_task(10)
    time.sleep(0.2)
    now = mot.current_velocity()
    mot.stop_motion_task()
    assert abs(now - 0.01) < 0.001, f"tells {now} m/s at 10 mm/s"

with call("jog_task") as saw, soon():
    start = mot.current_position()
    assert mot.jog_task(True, False, duration=0.5)
    forth = mot.current_position()
    assert forth > start + 1_000, f"jogged from {start} to {forth}"
    assert mot.jog_task(False, True, duration=0.5)
    assert mot.current_position() < forth - 1_000, "did not jog backwards"
    at(mot, mot.current_position(), saw)

with call("record_task") as saw, soon():
    assert mot.record_task(1, nonblocking=False)
    at(mot, 5_000, saw)
    assert mot.record_task(2, nonblocking=False)
    at(mot, 10_000, saw)

with call("over_v") as saw, soon():
    mot.over_v = 50.0
    begun = time.monotonic()
    assert mot.position_task(20_000, 20, absolute=True)
    assert time.monotonic() - begun > 0.9, "10 mm took less than 0.9 s at half of 20 mm/s"
    mot.over_v = 100.0
    at(mot, 20_000, saw)

with call("set_current_position_task") as saw, soon():
    assert mot.set_current_position_task(), "is not acknowledged or does not end"
    assert abs(mot.current_position()) <= CLOSE
    assert mot.referencing_task(), "homing afterwards does not end"
    at(mot, 0, saw)

with call("a target outside of the stroke, current_fault_code"), soon():
    assert not mot.position_task(500_000, 20, absolute=True), "takes a target outside of its stroke"
    assert mot.current_fault_code() == 110
    ready(mot)

with call("disable_powerstage, shutdown"), soon():
    assert mot.disable_powerstage(), "keeps its power"
    mot.shutdown()

with call("Telegram9Handler: enable_powerstage, referencing_task"), soon(), opened(Telegram9Handler) as drive:
    assert ready(drive).referencing_task(), "homing does not end"
    assert drive.referenced()

with call("Telegram1Handler: velocity_task"), soon(), opened(Telegram1Handler) as drive:
    assert ready(drive).velocity_task(2_000, duration=0.4)
    assert drive.telegram.nist_a.value == 2_000, f"tells the velocity {drive.telegram.nist_a.value}"

with call("Telegram102Handler: velocity_task"), soon(), opened(Telegram102Handler) as drive:
    assert ready(drive).velocity_task(-100_000_000, duration=0.4)
    assert abs(drive.telegram.nist_b.value + 100_000_000) < 1_000, f"tells {drive.telegram.nist_b.value}"

with call("MotionHandler after other telegrams"), soon(), opened(MotionHandler) as mot:
    assert ready(mot).position_task(1_000, 20)

not_tried("Telegram9Handler: position_task", "festo-edcon 1.0.3 itself ends it: its telegram 9 has no pos_stw1")
not_tried("configure_traversing_to_fixed_stop", "no torque is emulated")
not_tried("configure_measuring_probe", "no probe is emulated")
not_tried("ComEthernetip", "no EtherNet/IP is emulated")
os._exit(0)  # its threads do not end by themselves
