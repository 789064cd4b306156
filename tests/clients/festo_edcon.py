"""festo-edcon in front of a CMMT: each call that its pages and examples show, judged by what the client itself sees.

Source of the calls: the examples of github.com/Festo-se/festo-edcon (position, velocity, jog, record, pnu_access,
*_nonblock) and its page of the MotionHandler. `python festo_edcon.py HOST:PORT` in an environment with festo-edcon.
Lengths are micrometres, velocities mm/s, as the drive's parameters say. Only the port is changed in the client, which
knows 502 alone.
"""

from __future__ import annotations

import functools
import json
import logging
import os
import sys
import threading
import time
from collections.abc import Callable

from edcon.edrive import com_modbus
from edcon.edrive.com_modbus import ComModbus
from edcon.edrive.motion_handler import MotionHandler
from edcon.edrive.telegram1_handler import Telegram1Handler
from edcon.edrive.telegram9_handler import Telegram9Handler
from edcon.edrive.telegram102_handler import Telegram102Handler

LONGEST = 15.0
"""A call that takes longer blocks [s]."""
CLOSE = 60
"""Positions agree to so much [um]: a moving muscle pulls a little at the sensor."""
TELEGRAM, TARGET, FAULT, SERIAL, BASE = 3490, 34, 301, 2076, 12345


def told(call: str, do: Callable[[], object]) -> bool:
    """Carry out a call and print what came of it; whether it agrees. One that blocks ends the script."""
    found: list[dict[str, object]] = []

    def work() -> None:
        try:
            found.append({"ok": True, "why": "", "saw": do()})
        except Exception as error:
            found.append({"ok": False, "why": f"{type(error).__name__}: {error}"})

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(LONGEST)
    blocked = {"ok": False, "why": f"does not return within {LONGEST:g} s"}
    print(json.dumps({"call": call, **(found[0] if found else blocked)}), flush=True)
    if not found:
        os._exit(0)
    return bool(found[0]["ok"])


def not_tried(call: str, why: str) -> None:
    print(json.dumps({"call": call, "ok": None, "why": why}), flush=True)


def expect(condition: object, why: str) -> None:
    if not condition:
        raise AssertionError(why)


class Tour:
    """The calls in the order of the examples."""

    def __init__(self, com: ComModbus) -> None:
        self.com = com
        self.mot: MotionHandler

    def connect(self) -> object:
        expect(self.com.connected(), "is not connected")
        info = self.com.device_info
        expect(info["vendor_name"] and info["product_name"], f"tells no names: {info}")
        return info

    def set_timeout(self) -> object:
        expect(self.com.set_timeout(800), "does not hold the time-out")
        return 800

    def pnu_access(self) -> object:
        """The example: another telegram is selected, and the one before again."""
        before = self.com.read_pnu(TELEGRAM, 0)
        expect(before is not None, "does not tell the selected telegram")
        other = 1 if before != 1 else 111
        expect(self.com.write_pnu(TELEGRAM, 0, other), f"refuses telegram {other}")
        expect(self.com.read_pnu(TELEGRAM, 0) == other, f"does not hold telegram {other}")
        expect(self.com.write_pnu(TELEGRAM, 0, before), f"refuses telegram {before}")
        expect(not self.com.write_pnu(TELEGRAM, 0, 7), "takes telegram 7, which it does not have")
        return before

    def pnus(self) -> object:
        found = {pnu: self.com.read_pnu(pnu) for pnu in (TARGET, FAULT, SERIAL, BASE)}
        expect(all(value is not None for value in found.values()), f"tells not all: {found}")
        expect(self.com.read_pnu(2) is not None, "does not tell ZSW1")
        return {str(pnu): value.decode() if isinstance(value, bytes) else value for pnu, value in found.items()}

    def validate(self) -> object:
        self.mot = MotionHandler(self.com, config_mode="write")
        return self.mot.current_position()

    def acknowledge(self) -> object:
        expect(self.mot.acknowledge_faults(), "keeps a fault")
        return self.mot.current_fault_code()

    def enable(self) -> object:
        expect(self.mot.enable_powerstage(), "is not enabled")
        expect(self.mot.ready_for_motion(), "is not ready for motion")
        return True

    def home(self) -> object:
        expect(self.mot.referencing_task(), "homing is not acknowledged or does not end")
        expect(self.mot.referenced(), "is not referenced after homing")
        return self.at(0)

    def at(self, position: int) -> int:
        now = self.mot.current_position()
        expect(abs(now - position) <= CLOSE, f"stands at {now} and not at {position}")
        return now

    def absolute(self) -> object:
        expect(self.mot.position_task(10_000, 20, absolute=True), "the absolute task fails")
        return self.at(10_000)

    def relative(self) -> object:
        expect(self.mot.position_task(5_000, 20), "the relative task fails")
        self.at(15_000)
        expect(self.mot.position_task(-3_000, 20), "the relative task backwards fails")
        return self.at(12_000)

    def nonblocking(self) -> object:
        expect(self.mot.position_task(8_000, 20, absolute=True, nonblocking=True), "is not taken")
        time.sleep(0.1)
        expect(not self.mot.target_position_reached(), "says at once that it is there")
        self.wait(self.mot.target_position_reached, "target")
        self.mot.stop_motion_task()
        return self.at(8_000)

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        until = time.monotonic() + 5
        while not condition():
            expect(time.monotonic() < until, f"no {what} within 5 s")
            time.sleep(0.02)

    def continuous(self) -> object:
        self.mot.configure_continuous_update(True)
        expect(self.mot.position_task(4_000, 20, absolute=True, nonblocking=True), "is not taken")
        time.sleep(0.05)
        self.mot.position_task(6_000, 20, absolute=True, nonblocking=True)
        time.sleep(0.6)
        self.mot.stop_motion_task()
        self.mot.configure_continuous_update(False)
        return self.at(6_000)

    def pause(self) -> object:
        expect(self.mot.position_task(14_000, 10, absolute=True, nonblocking=True), "is not taken")
        time.sleep(0.2)
        self.mot.pause_motion_task()
        paused = self.mot.current_position()
        time.sleep(0.2)
        self.at(paused)
        expect(paused < 13_000, f"was not stopped before its target ({paused})")
        self.mot.resume_motion_task()
        time.sleep(1.0)
        return [paused, self.at(14_000)]

    def velocity(self) -> object:
        before = self.mot.current_position()
        expect(self.mot.velocity_task(10, 0.5), "the velocity task fails")
        forth = self.mot.current_position()
        expect(3_000 < forth - before < 9_000, f"went from {before} to {forth} in 0.5 s at 10 mm/s")
        expect(self.mot.velocity_task(-10, 0.5), "the velocity task backwards fails")
        back = self.mot.current_position()
        expect(back < forth - 3_000, f"went from {forth} to {back} in 0.5 s at -10 mm/s")
        return [before, forth, back]

    def current_velocity(self) -> object:
        self.mot.base_velocity = self.com.read_pnu(BASE)
        expect(self.mot.velocity_task(10), "the velocity task fails")
        time.sleep(0.2)
        now = self.mot.current_velocity()
        self.mot.stop_motion_task()
        expect(abs(now - 0.01) < 0.001, f"tells {now} m/s at 10 mm/s")
        return now

    def jog(self) -> object:
        before = self.mot.current_position()
        expect(self.mot.jog_task(True, False, duration=0.5), "jogging fails")
        forth = self.mot.current_position()
        expect(forth > before + 1_000, f"jogged from {before} to {forth}")
        expect(self.mot.jog_task(False, True, duration=0.5), "jogging backwards fails")
        expect(self.mot.current_position() < forth - 1_000, "did not jog backwards")
        return [before, forth]

    def record(self) -> object:
        found = []
        for number, position in ((1, 5_000), (2, 10_000)):
            expect(self.mot.record_task(number, nonblocking=False), f"record {number} fails")
            found.append(self.at(position))
        return found

    def override(self) -> object:
        self.mot.over_v = 50.0
        begun = time.monotonic()
        expect(self.mot.position_task(20_000, 20, absolute=True), "the task fails")
        took = time.monotonic() - begun
        self.mot.over_v = 100.0
        expect(took > 0.9, f"10 mm at 50 % of 20 mm/s took {took:.2f} s")
        return self.at(20_000)

    def reference_here(self) -> object:
        expect(self.mot.set_current_position_task(), "is not acknowledged or does not end")
        self.at(0)
        expect(self.mot.referencing_task(), "homing afterwards fails")
        return self.at(0)

    def fault(self) -> object:
        expect(not self.mot.position_task(500_000, 20, absolute=True), "takes a target outside of its stroke")
        code = self.mot.current_fault_code()
        expect(code, "tells no fault code")
        expect(self.mot.acknowledge_faults() and self.mot.enable_powerstage(), "does not recover from its fault")
        return code

    def disable(self) -> object:
        expect(self.mot.disable_powerstage(), "keeps its power")
        self.mot.shutdown()
        return True


def by_velocity(handler: Callable[..., Telegram1Handler], speed: int, connect: Callable[[], ComModbus]) -> object:
    """A telegram of which the set-point is a velocity: the examples of the command line."""
    with handler(connect(), config_mode="write") as drive:
        expect(drive.acknowledge_faults(), "keeps a fault")
        expect(drive.enable_powerstage(), "is not enabled")
        expect(drive.velocity_task(speed, duration=0.4), "the velocity task fails")
        return True


def telegram9(connect: Callable[[], ComModbus]) -> object:
    with Telegram9Handler(connect(), config_mode="write") as drive:
        expect(drive.acknowledge_faults(), "keeps a fault")
        expect(drive.enable_powerstage(), "is not enabled")
        expect(drive.referencing_task(), "homing fails")
        expect(drive.referenced(), "is not referenced after homing")
        return drive.telegram.xist_a.value


def main(address: str) -> None:
    logging.disable(logging.CRITICAL)
    host, _, port = address.rpartition(":")
    com_modbus.ModbusClient = functools.partial(com_modbus.ModbusClient, port=int(port))

    def connect() -> ComModbus:
        return ComModbus(host)

    tour = Tour(connect())
    told("ComModbus (connect, read_device_info)", tour.connect)
    told("ComModbus.set_timeout", tour.set_timeout)
    told("read_pnu, write_pnu (telegram selection 3490)", tour.pnu_access)
    told("read_pnu (target, fault, serial number, base velocity)", tour.pnus)
    told("MotionHandler(config_mode='write')", tour.validate)
    told("acknowledge_faults", tour.acknowledge)
    told("enable_powerstage, ready_for_motion", tour.enable)
    told("referencing_task, referenced", tour.home)
    told("position_task(absolute=True)", tour.absolute)
    told("position_task (relative)", tour.relative)
    told("position_task(nonblocking=True), target_position_reached", tour.nonblocking)
    told("configure_continuous_update", tour.continuous)
    told("pause_motion_task, resume_motion_task", tour.pause)
    told("velocity_task", tour.velocity)
    told("current_velocity", tour.current_velocity)
    told("jog_task", tour.jog)
    told("record_task", tour.record)
    told("over_v", tour.override)
    told("set_current_position_task", tour.reference_here)
    told("a target outside of the stroke, current_fault_code", tour.fault)
    told("disable_powerstage, shutdown", tour.disable)
    told("Telegram9Handler (enable, referencing_task)", lambda: telegram9(connect))
    told("Telegram1Handler", lambda: by_velocity(Telegram1Handler, -1_000, connect))
    told("Telegram102Handler", lambda: by_velocity(Telegram102Handler, 100_000_000, connect))
    told(
        "MotionHandler after other telegrams", lambda: MotionHandler(connect(), config_mode="write").current_position()
    )
    not_tried("Telegram9Handler.position_task", "festo-edcon 1.0.3 itself ends it: Telegram9 has no pos_stw1")
    not_tried("configure_traversing_to_fixed_stop", "no torque is emulated")
    not_tried("configure_measuring_probe", "no probe is emulated")
    not_tried("ComEthernetip", "no EtherNet/IP is emulated")
    os._exit(0)  # its threads do not end by themselves


if __name__ == "__main__":
    main(sys.argv[1])
