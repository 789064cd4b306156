"""NI's package `nidaqmx` for one device: calls that end in time, and its errors as DeviceError.

Over gRPC each task has a name on the server, where it outlives the program that made it: a program that opens the
device ends the tasks left over by another one of this computer, and a second connection commands through the same
tasks. No output task stays started, so nothing is reserved between two commands, and another program can always vent.
"""

from __future__ import annotations

import socket
import threading
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from time import monotonic
from typing import Any

from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import EMULATED, Identity
from pmabench_drivers.ni_daq.options import Input, Options, Output
from pmabench_drivers.shared.link import Unanswered

SHORTEST = 0.001
"""Time for a call if none is left [s]."""
BUFFER = 10.0
"""Length of the buffer of waiting samples [s]."""
MOST = 4000
"""Largest number of samples of each input that are read at once."""
REASONS = {
    -200220: "NI-DAQmx knows no device of this name",
    -200170: "the device has no such channel",
    -200324: "the device is absent or was unplugged",
    -201003: "the device cannot be reached: is it plugged in, and has it power?",
    -50103: "it is reserved by another program or task: end that one first",
    -200587: "the line is reserved by another program or task: end that one first",
    -200279: "samples were overwritten before they were read",
    -200222: "sampling was ended because samples were not read in time",
    -200361: "samples were lost inside the device: its memory overflowed on the way to the computer",
    -200714: "samples were lost inside the device: the connection is too slow for the rate",
    -200088: "the task is gone: the server was restarted, or another program took the device",
}
"""Frequent errors of NI-DAQmx, in plain words."""


class Bounded:
    """A separate gRPC connection whose calls end in time; nothing is sent twice."""

    def __init__(self, server: str, left: Callable[[], float]) -> None:
        import grpc

        options = {
            "grpc.enable_http_proxy": 0,
            "grpc.enable_retries": 0,
            "grpc.use_local_subchannel_pool": 1,
            "grpc.initial_reconnect_backoff_ms": 100,
            "grpc.min_reconnect_backoff_ms": 500,
            "grpc.max_reconnect_backoff_ms": 500,
        }
        self._channel, self._left = grpc.insecure_channel(server, list(options.items())), left

    def unary_unary(self, *names: Any, **how: Any) -> Callable[..., Any]:
        """One request and one answer."""
        call = self._channel.unary_unary(*names, **how)

        def bounded(request: Any, metadata: Any = None) -> Any:
            return call(request, timeout=self._left(), metadata=metadata)

        return bounded

    def __getattr__(self, name: str) -> Any:
        return getattr(self._channel, name)


class Connection:
    """One connection to a device: NI-DAQmx here, or a separate connection to a server."""

    def __init__(self, name: str, options: Options) -> None:
        self._name, self._options = name, options
        self._until = threading.local()
        self._channel: Any = None
        self._tasks: dict[str, Any] = {}
        self._writers: dict[str, Callable[[Any], object]] = {}
        self._readers: dict[str, Callable[[], bool]] = {}
        self._samples: Any = None
        self._device: Any = None

    # -- every call -----------------------------------------------------------------------------------------------

    @contextmanager
    def calls(self, seconds: float, what: str = "") -> Iterator[None]:
        """Calls that together end within a time [s]; whatever they raise becomes a DeviceError."""
        self._until.moment = monotonic() + seconds
        try:
            yield
        except DeviceError:
            raise
        except Exception as error:  # the package raises its own errors, gRPC's, and assertions
            raise self._explained(error, seconds, what) from None

    def left(self) -> float:
        """Time left for the calls of this thread [s]."""
        return max(SHORTEST, float(self._until.moment) - monotonic())

    def _explained(self, error: Exception, seconds: float, what: str) -> DeviceError:
        if isinstance(error, ImportError):
            message = f'the Python package of NI is not installed ({error}): pip install "pmabench[ni]"'
            return DeviceError(self._name, message, what)
        from nidaqmx.errors import DaqError, DaqNotFoundError, DaqNotSupportedError, RpcError

        if isinstance(error, DaqNotFoundError | DaqNotSupportedError):
            server = 'give the address of NI\'s gRPC server where it is: "options: {server: HOST:31763}"'
            message = f"NI-DAQmx, NI's driver, is not on this computer: install it from NI, or {server}"
            return DeviceError(self._name, message, what)
        if isinstance(error, DaqError):
            code = int(error.error_code)
            text = _short(str(error).split("\n\n", 1)[0], 200)
            return DeviceError(self._name, f"{REASONS.get(code, text)} (NI-DAQmx error {code})", what)
        if isinstance(error, RpcError):
            return self._unreached(error, seconds, what)
        return DeviceError(self._name, f"gave an answer that is none ({type(error).__name__}: {_short(error)})", what)

    def _unreached(self, error: Any, seconds: float, what: str) -> DeviceError:
        server, kind = self._options.server, getattr(error.rpc_code, "name", str(error.rpc_code))
        if kind == "DEADLINE_EXCEEDED":
            return Unanswered(self._name, f"{server} did not answer within {seconds:g} s", what)
        if kind == "UNAVAILABLE":
            return Unanswered(self._name, f"no connection to NI's gRPC server at {server}", what)
        if kind == "UNIMPLEMENTED":
            return DeviceError(self._name, f"{server} is no NI gRPC server, or one without NI-DAQmx, or too old", what)
        text = _short(error.description or "", 200)
        return Unanswered(self._name, f"{server} failed: {kind.lower().replace('_', ' ')} ({text})", what)

    # -- life -----------------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Import NI's package, which takes some time."""
        parts = ["stream_readers", "stream_writers", "system", *(["_grpc_interpreter"] if self._options.server else [])]
        for part in parts:
            import_module(f"nidaqmx.{part}")

    def open(self) -> Identity:
        """Connect, find the device, check that it has what the bench uses, and prepare its tasks; commands nothing."""
        system = self._system()
        names = [_short(name) for name in system.devices.device_names]
        if (wanted := self._options.device) not in names:
            hint = did_you_mean(wanted, names[:9]) or "; it knows none"
            raise DeviceError(self._name, f'NI-DAQmx knows no device "{wanted}"{hint}')
        device = system.devices[wanted]
        self._refuse_missing(device)
        for output in self._options.outputs:
            self._prepare_output(output, self._range(device, output))
        for line in (*self._options.valves, *self._options.levels):
            self._prepare_line(line, out=line in self._options.valves)
        if self._options.inputs:
            self._prepare_samples(list(self._options.inputs.values()))
            self._fastest = float(device.ai_max_multi_chan_rate)
        self._device = device
        model, serial, version = _short(device.product_type), self.serial(), system.driver_version
        simulated = bool(device.is_simulated) or model.startswith(EMULATED)
        if simulated and not model.startswith(EMULATED):
            model = f"{EMULATED}{model}"
        return Identity("NI", model, serial, f"NI-DAQmx {'.'.join(map(str, version))}", simulated=simulated)

    def serial(self) -> str:
        """The serial number, read now."""
        return f"{int(self._device.serial_num):X}"

    def refuse_lost(self) -> None:
        """Read the state of a task; raises DeviceError if server or device restarted and the task is gone."""
        for task in list(self._tasks.values())[:1]:
            task.is_task_done()

    def attach(self) -> None:
        """Connect, and attach to the outputs and valve lines that another connection has prepared."""
        self._connect()
        for output in self._options.outputs:
            self._prepare_output(output, None)
        for line in self._options.valves:
            self._prepare_line(line, out=True, attach=True)

    def close(self) -> None:
        """Close the tasks that this connection has made, and the connection; outputs stay as they are."""
        for task in self._tasks.values():
            with suppress(Exception):  # a server that has ended has no tasks
                task.close()
        self._tasks.clear()
        self._writers, self._readers, self._samples = {}, {}, None
        self.hang_up()

    def hang_up(self) -> None:
        """Close only the connection."""
        channel, self._channel = self._channel, None
        if channel is not None:
            with suppress(Exception):
                channel.close()

    def _connect(self) -> None:
        if self._options.server:
            self._channel = Bounded(self._options.server, self.left)

    def _system(self) -> Any:
        self._connect()
        from nidaqmx.system import System

        return System.remote(self._session("")) if self._options.server else System.local()

    def _session(self, name: str, *, attach: bool = False) -> Any:
        """Name of a task on the server, and whether it must already exist."""
        if not self._options.server:
            return None
        from nidaqmx import GrpcSessionOptions, SessionInitializationBehavior

        way = SessionInitializationBehavior
        behaviour = way.ATTACH_TO_SERVER_SESSION if attach else way.AUTO
        return GrpcSessionOptions(self._channel, name, initialization_behavior=behaviour)

    # -- tasks ----------------------------------------------------------------------------------------------------

    def _task(self, key: str, *, attach: bool = False) -> Any:
        """A task of this device; a new one unless `attach`: a task left over on the server is closed first."""
        from nidaqmx import Task

        name = f"pmabench {socket.gethostname()} {self._options.device} {key}"
        task = Task(name, grpc_options=self._session(name, attach=attach))
        if self._options.server and not attach and task.number_of_channels:
            task.close()
            task = Task(name, grpc_options=self._session(name))
        if not attach:
            self._tasks[key] = task
        return task

    def _prepare_output(self, output: str, limits: tuple[float, float] | None) -> None:
        """Prepare a task for one output; `limits` None: it already exists."""
        from nidaqmx.stream_writers import AnalogSingleChannelWriter

        task = self._task(output, attach=limits is None)
        if limits is not None:
            low, high = limits
            channel = task.ao_channels.add_ao_voltage_chan(self._physical(output), min_val=low, max_val=high)
            self._refuse_finer(output, (high - low) / 2 ** float(channel.ao_resolution))
        writer = AnalogSingleChannelWriter(task.out_stream, auto_start=True)
        self._writers[output] = lambda value: writer.write_one_sample(value, timeout=self.left())

    def _prepare_line(self, line: str, *, out: bool, attach: bool = False) -> None:
        from nidaqmx.stream_readers import DigitalSingleChannelReader
        from nidaqmx.stream_writers import DigitalSingleChannelWriter

        task = self._task(line, attach=attach)
        if not attach:
            (task.do_channels.add_do_chan if out else task.di_channels.add_di_chan)(self._physical(line))
        if out:
            writer = DigitalSingleChannelWriter(task.out_stream, auto_start=True)
            self._writers[line] = lambda on: writer.write_one_sample_one_line(bool(on), timeout=self.left())
        reader = DigitalSingleChannelReader(task.in_stream)
        self._readers[line] = lambda: bool(reader.read_one_sample_one_line(timeout=self.left()))

    def _prepare_samples(self, inputs: Sequence[Input]) -> None:
        from nidaqmx.constants import TerminalConfiguration
        from nidaqmx.stream_readers import AnalogMultiChannelReader

        task = self._task("ai")
        for item in inputs:
            kind = TerminalConfiguration[item.terminal]
            where = self._physical(item.name)
            task.ai_channels.add_ai_voltage_chan(where, terminal_config=kind, min_val=-item.span, max_val=item.span)
        self._samples = AnalogMultiChannelReader(task.in_stream)
        self._samples.verify_array_shape = False

    def _physical(self, name: str) -> str:
        return f"{self._options.device}/{name}"

    # -- what the device has ----------------------------------------------------------------------------------------

    def _refuse_missing(self, device: Any) -> None:
        """Check that every channel, line and range that the bench uses exists."""
        options, model = self._options, _short(device.product_type)
        groups: tuple[tuple[str, Any, Sequence[str]], ...] = (
            ("analogue input", device.ai_physical_chans, [item.name for item in options.inputs.values()]),
            ("analogue output", device.ao_physical_chans, list(options.outputs)),
            ("digital output", device.do_lines, options.valves),
            ("digital input", device.di_lines, options.levels),
        )
        for kind, group, wanted in groups:
            has = [_short(name).partition("/")[2] for name in group.channel_names] if wanted else []
            for name in wanted:
                if name not in has:
                    known = f"; its last one is {has[-1]}" if has else "; it has none"
                    raise DeviceError(self._name, f'a {model} has no {kind} "{name}"{known}', name)
        spans = [float(high) for high in list(device.ai_voltage_rngs)[1:40:2]] if options.inputs else []
        for item in options.inputs.values():
            if not any(abs(span - item.span) < 1e-6 for span in spans):
                shown = ", ".join(f"{span:g} V" for span in spans)
                raise DeviceError(self._name, f"a {model} has no range of {item.span:g} V; it has {shown}", item.name)

    def _range(self, device: Any, output: str) -> tuple[float, float]:
        """The narrowest output range that includes every commanded value [V]."""
        wanted: Output = self._options.outputs[output]
        low, high = wanted.low, wanted.high
        ends = [float(end) for end in list(device.ao_voltage_rngs)[:40]]
        ranges = [pair for pair in zip(ends[::2], ends[1::2], strict=False) if pair[0] <= low and high <= pair[1]]
        if not ranges:
            shown = ", ".join(f"{a:g} V to {b:g} V" for a, b in zip(ends[::2], ends[1::2], strict=False))
            message = f"would need {low:g} V to {high:g} V, and a {_short(device.product_type)} gives {shown or 'none'}"
            raise DeviceError(self._name, message, output)
        return min(ranges, key=lambda pair: pair[1] - pair[0])

    def _refuse_finer(self, output: str, step: float) -> None:
        """Refuse a resolution in the bench file that is finer than the converter's."""
        given = self._options.outputs[output].step
        if not given >= 0.99 * step:
            message = f'the bench file says steps of {given:g} V, and they are {step:.3g} V: "resolution: {step:.6f} V"'
            raise DeviceError(self._name, message, output)

    # -- outputs and lines ------------------------------------------------------------------------------------------

    def write(self, name: str, value: float) -> None:
        """Set an output [V], or a valve line (0 or 1), once."""
        self._known(self._writers, name)(value)

    def level(self, line: str) -> bool:
        """The level of a line, also of a driven one."""
        return bool(self._known(self._readers, line)())

    def _known(self, prepared: dict[str, Any], name: str) -> Any:
        if name not in prepared:
            raise DeviceError(self._name, "is not open", name)
        return prepared[name]

    # -- samples ----------------------------------------------------------------------------------------------------

    def begin(self, rate: float) -> float:
        """Sample at `rate` [Hz]; returns the rate that the device uses."""
        from nidaqmx.constants import AcquisitionType, TaskMode

        task, inputs = self._tasks.get("ai"), self._options.inputs
        if task is None:
            raise DeviceError(self._name, "is not open" if inputs else "has no channel to sample")
        if rate * len(inputs) > self._fastest:
            message = f"cannot take {rate * len(inputs):g} samples a second: at most {self._fastest:g}"
            raise DeviceError(self._name, f"{message}, over all channels")
        self.end()
        kept = max(2, round(BUFFER * rate))
        task.timing.cfg_samp_clk_timing(rate, sample_mode=AcquisitionType.CONTINUOUS, samps_per_chan=kept)
        task.control(TaskMode.TASK_COMMIT)
        used = float(task.timing.samp_clk_rate)
        if not abs(used / rate - 1) < 0.1:
            raise DeviceError(self._name, f"would sample at {used:g} Hz where {rate:g} Hz is asked for")
        task.start()
        return used

    def end(self) -> None:
        """Stop sampling; may be called again."""
        from nidaqmx.constants import TaskMode

        if (task := self._tasks.get("ai")) is not None:
            task.stop()
            task.control(TaskMode.TASK_UNRESERVE)

    def position(self) -> int:
        """Number of the next sample to be read."""
        return int(self._tasks["ai"].in_stream.curr_read_pos)

    def read(self) -> list[array[float]]:
        """Waiting samples, at most `MOST`, an array [V] for each input."""
        import numpy as np

        if (waiting := min(int(self._tasks["ai"].in_stream.avail_samp_per_chan), MOST)) <= 0:
            return []
        data = np.full((len(self._options.inputs), waiting), np.nan)
        got = int(self._samples.read_many_sample(data, waiting, timeout=self.left()))
        if got != waiting:
            raise DeviceError(self._name, f"gave {got} samples where {waiting} waited")
        return [array("d", row.tobytes()) for row in data]


def _short(text: object, longest: int = 60) -> str:
    """A text from outside, in one line and of limited length."""
    return " ".join(str(text).split())[:longest]
