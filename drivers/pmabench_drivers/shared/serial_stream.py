"""What drivers of serial devices that send by themselves share: open, listen, collect, hush; knows no device."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, DeviceRecord, Identity
from pmabench_drivers.shared.device import Driver
from pmabench_drivers.shared.link import opened
from pmabench_drivers.shared.polling import Samples
from pmabench_drivers.shared.serial_port import SerialPort

PATIENCE = 0.5
"""So long nothing usable may come before `collect` says so [s]."""


class SerialStream(Driver):
    """One device on a port of its own; a kind of device says how it is greeted, quieted and read."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._port: SerialPort | None = None
        self._forget()

    @abstractmethod
    def _greet(self) -> Identity:
        """Quiet it, see that it is the right device, and set it."""

    @abstractmethod
    def _quiet(self) -> None:
        """End a stream that may be under way."""

    @abstractmethod
    def _take(self, data: bytes, now: float) -> None:
        """Bytes that came at `now` [s, bench time], on the port's thread; what ends the stream goes to `_failure`."""

    @abstractmethod
    def _missing(self) -> str:
        """What is said where nothing usable has come for too long."""

    def _forget(self) -> None:
        """Nothing has come yet."""
        self._samples = Samples([channel.name for channel in self._device.channels])
        self._failure = ""
        self._heard = monotonic()

    def open(self) -> Identity:
        """Quiet it, see that it is the right device, and set what a true record needs; nothing is saved in it."""
        self.close()
        self._port = SerialPort(self._device.name, self._device.address, self._options.baud, self._clock)
        with self._closed_on_error():
            return self._greet()

    def close(self) -> None:
        """Quiet it and let go of the port."""
        port = self._port
        if port is not None:
            self.stop()
            self._port = None
            port.close()

    def collect(self) -> Block:
        """What came since the last call; an error where it is silent, or the stream has failed."""
        port = self._opened()
        why = port.gone or self._failure
        if not why and port.listening and monotonic() - self._heard > self._patience:
            why = f"{self._missing()} for {PATIENCE:g} s"
        if why:
            raise self._error(why)
        return self._samples.take()

    def stop(self) -> None:
        """End the stream; harmless when repeated."""
        port = self._port
        if port is not None and port.listening:
            port.hush()
            with contextlib.suppress(DeviceError):  # a port that is lost sends nothing either
                self._quiet()

    @property
    def _patience(self) -> float:
        return PATIENCE

    def _ready(self, rate: float) -> SerialPort:
        """The port, quiet, for a stream that begins."""
        self._refuse_rate(rate)
        port = self._opened()
        self.stop()
        return port

    def _opened(self) -> SerialPort:
        return opened(self._port, self._device.name)
