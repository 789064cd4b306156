"""NI's gRPC server, emulated: the calls of the package `nidaqmx` that a bench needs, for one board."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator import faults as f
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import refuse_others
from pmabench_drivers.ni_daq.emulated_tasks import AI, AO, BITS, DI, DO, FASTEST, SPANS, Board, Refused, Task
from pmabench_drivers.ni_daq.options import read_options
from pmabench_drivers.shared.options import options_of

SERVICE = "nidaqmx_grpc.NiDAQmx"
LINKS = {name: f.LINK[name] for name in f.LINK if name not in {"late", "stale", "double"}}
"""An answer of gRPC belongs to its request: none comes twice, or to another one."""
ATTACH, INITIALIZE = 2, 1
VERSION = {0x1272: 24, 0x1923: 5, 0x2F22: 0}
"""Attributes of the system: major, minor, update."""
CONTINUOUS = 10123
"""The kind of timing that is supported."""
WORKERS = 16
"""Largest number of simultaneous calls."""
GIVE_UP = 10.0
"""Longest wait for a client to give up [s]."""

Answer = dict[str, Any]


def serve(device: DeviceRecord, plant: RealPlant, log: f.CommandLog) -> EmulatedServer:
    """Emulated server for a device of the driver `ni-daqmx`."""
    options = options_of(device, read_options)
    if not options.server:
        why = 'its bench file names no server; an emulator needs "options: {server: 127.0.0.1:PORT}"'
        raise UsageError(f"cannot serve {device.name}: {why}")
    refuse_others(device.name, options.server)
    try:
        return EmulatedServer(Board(device, plant, log), options.server, log)
    except ImportError as error:
        why = f'the Python package of NI is not installed ({error}): pip install "pmabench[ni]"'
        raise UsageError(f"cannot serve {device.name}: {why}") from None


class EmulatedServer:
    """Listens on `address`; port 0 takes a free one."""

    def __init__(self, board: Board, address: str, log: f.CommandLog) -> None:
        from nidaqmx._stubs import nidaqmx_pb2  # noqa: PLC2701  (the messages of the wire; there is no other source)

        self.board, self.faults = board, f.Faults(LINKS, f.STUCK, f.IGNORE, f.EXCEPTION, f.RESTART, f.SETPOINT)
        self.restart, self.change_set_point = board.restart, board.change_set_point
        self._messages: Any = nidaqmx_pb2
        self._tap = log.tap(board.device.name)
        self._peers: dict[str, int] = {}
        self._lock = threading.Lock()
        self.requests: list[str] = []
        """Names of the calls so far."""
        self._server: Any = None
        self.address = address
        self._listen()

    def _listen(self) -> None:
        from concurrent.futures import ThreadPoolExecutor

        import grpc

        workers = ThreadPoolExecutor(WORKERS)
        server = grpc.server(workers, options=[("grpc.so_reuseport", 0)])
        known = {name: self._handler(grpc, name) for name in CALLS}
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, known),))
        try:
            port = server.add_insecure_port(self.address)
        except RuntimeError:
            port = 0
        if not port:
            raise UsageError(f"cannot serve {self.board.device.name} at {self.address}: the port is taken")
        all_there = threading.Barrier(WORKERS)
        for _ in range(WORKERS):  # now: a thread that starts later would look like one left behind by a driver
            workers.submit(all_there.wait)
        self.address = f"{self.address.rpartition(':')[0]}:{port}"
        self._server = server

    def start(self) -> None:
        """Start serving."""
        self._server.start()

    def close(self) -> None:
        """Stop serving."""
        self.board.close()
        self._server.stop(0.0).wait(2.0)

    def serve_again(self, *, forget: bool) -> None:
        """Cut every connection, and listen again; `forget`: without the tasks, like a restarted server."""
        with self._lock:
            self._server.stop(0.0).wait(2.0)
            if forget:
                with self.board.lock:
                    self.board.tasks.clear()
            self._listen()
            self._server.start()

    # -- one call ---------------------------------------------------------------------------------------------------

    def _handler(self, grpc: Any, name: str) -> Any:
        request = getattr(self._messages, f"{name}Request")

        def answer(data: bytes, context: Any) -> bytes:
            self._tap("received", name.encode() + b" " + data)
            return self._answer(grpc, name, request.FromString(data), context)

        return grpc.unary_unary_rpc_method_handler(answer)

    def _answer(self, grpc: Any, name: str, request: Any, context: Any) -> bytes:
        self.requests.append(name)
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            again = threading.Thread(target=self.serve_again, kwargs={"forget": fault.kind == "reset"}, daemon=True)
            again.start()
        if fault.kind in {"hang-up", "reset", "silence"}:
            return _wait(context)
        if fault.kind == "exception":
            _refuse(grpc, context, Refused(int(fault.value), "An error that was asked for."))
        try:
            if name == "ReadAnalogF64":
                self.wait(request, context)
            with self.board.lock:
                fields = CALLS[name](self, request, context, fault)
        except Refused as refused:
            _refuse(grpc, context, refused)
        data = bytes(getattr(self._messages, f"{name}Response")(**fields).SerializeToString())
        if fault.kind == "lost":
            return _wait(context)
        if fault.kind == "delay":
            time.sleep(fault.value)
        data = f.damaged(data, fault)
        self._tap("sent", data)
        return data

    def connection(self, context: Any) -> int:
        """A number for each client."""
        return self._peers.setdefault(context.peer(), len(self._peers))

    # -- what the calls do ------------------------------------------------------------------------------------------

    def create_task(self, request: Any, context: Any) -> Answer:
        """Create a task, or attach to an existing one."""
        import grpc

        way = request.initialization_behavior
        unnamed = (f"_unnamedTask<{number}>" for number in count())
        name = request.session_name or next(name for name in unnamed if name not in self.board.tasks)
        there = name in self.board.tasks
        if way == ATTACH and not there:
            context.abort(grpc.StatusCode.FAILED_PRECONDITION, f"Cannot attach to '{name}': there is no such session.")
        if way == INITIALIZE and there:
            context.abort(grpc.StatusCode.ALREADY_EXISTS, f"Cannot initialize '{name}': there is such a session.")
        if not there:
            self.board.tasks[name] = Task()
        return {"task": {"name": name}, "new_session_initialized": not there}

    def write(self, request: Any, context: Any, fault: f.Fault) -> Answer:
        """Set the one output of a task."""
        task = self.board.task(request.task.name)
        if fault.kind != "ignore":
            self.board.set_output(task, request.value, self.connection(context), start=request.auto_start)
        return {}

    def write_line(self, request: Any, context: Any, fault: f.Fault) -> Answer:
        """Set the one line of a task."""
        task, high = self.board.task(request.task.name), bool(request.write_array[-1])
        if fault.kind != "ignore":
            self.board.set_line(task, self.connection(context), high=high, start=request.auto_start)
        return {"samps_per_chan_written": 1}

    def read(self, request: Any) -> Answer:
        """Samples of a task."""
        data = self.board.fetch(self.board.task(request.task.name), request.num_samps_per_chan)
        return {"read_array": data, "samps_per_chan_read": request.num_samps_per_chan}

    def read_line(self, request: Any) -> Answer:
        """The level of the one line of a task."""
        levels = bytes(self.board.level(name) for name in self.board.task(request.task.name).names)
        return {"read_array": levels, "samps_per_chan_read": 1, "num_bytes_per_samp": 1}

    def wait(self, request: Any, context: Any) -> None:
        """Wait until the requested samples are available, or the time of the request is over."""
        until = time.monotonic() + (request.timeout if request.timeout >= 0 else GIVE_UP)
        while context.is_active():
            with self.board.lock:
                there = self.board.waiting(self.board.task(request.task.name)) >= request.num_samps_per_chan
            if there or time.monotonic() >= until:
                return
            time.sleep(0.002)


def _attribute(name: str) -> Callable[..., Answer]:
    """The call that reads an attribute."""

    def call(server: EmulatedServer, request: Any, _context: Any, _fault: f.Fault) -> Answer:
        if name.startswith("GetDevice") and request.device_name != server.board.device.address:
            raise Refused(-200220, "Device identifier is invalid.")
        get = ATTRIBUTES.get((name.removeprefix("Get").replace("Attribute", " "), request.attribute_raw))
        if get is None:
            message = "Specified property is not supported by the device or is not applicable to the task."
            raise Refused(-200452, message)
        return {"value_raw" if name.endswith("AttributeInt32") else "value": get(server.board, request)}

    return call


def _refuse(grpc: Any, context: Any, refused: Refused) -> None:
    """Report an error of NI-DAQmx as the server does: its code is in the metadata."""
    context.set_trailing_metadata((("ni-error", str(refused.code)),))
    context.abort(grpc.StatusCode.UNKNOWN, str(refused))


def _wait(context: Any) -> bytes:
    """Give no answer, until the client has given up."""
    until = time.monotonic() + GIVE_UP
    while context.is_active() and time.monotonic() < until:
        time.sleep(0.005)
    return b""


def _of_task(act: Callable[[Board, Task, Any], object]) -> Callable[..., Answer]:
    """A call that acts on a task and has an empty answer."""

    def call(server: EmulatedServer, request: Any, _context: Any, _fault: f.Fault) -> Answer:
        act(server.board, server.board.task(request.task.name), request)
        return {}

    return call


def _add_output(board: Board, task: Task, request: Any) -> None:
    board.add(task, "ao", request.physical_channel, AO)
    task.spans.append((request.min_val, request.max_val))


def _configure(board: Board, task: Task, request: Any) -> None:
    if request.sample_mode_raw != CONTINUOUS:
        raise Refused(-200077, "Requested value is not a supported value for this property.")
    board.configure(task, request.rate, request.samps_per_chan)


def _stop(_board: Board, task: Task, _request: Any) -> None:
    task.state = "committed" if task.state == "running" else task.state


def _task(act: Callable[[Task], Any]) -> Callable[[Board, Any], Any]:
    """An attribute of the task that a request names."""
    return lambda board, request: act(board.task(request.task.name))


def _always(value: Any) -> Callable[[Board, Any], Any]:
    """An attribute that never changes."""
    return lambda _board, _request: value


def _list(names: tuple[str, ...]) -> Callable[[Board, Any], str]:
    return lambda board, _request: ", ".join(f"{board.device.address}/{name}" for name in names)


ATTRIBUTES: dict[tuple[str, int], Callable[[Board, Any], Any]] = {
    **{("SystemInfo UInt32", key): _always(part) for key, part in VERSION.items()},
    ("SystemInfo String", 0x193B): lambda board, _r: board.device.address,
    ("Device String", 0x0631): lambda board, _r: board.model,
    **{("Device String", key): _list(names) for key, names in {0x231E: AI, 0x231F: AO, 0x2320: DI, 0x2322: DO}.items()},
    ("Device UInt32", 0x0632): _always(0),
    ("Device Bool", 0x22CA): _always(False),
    ("Device Double", 0x298D): _always(FASTEST),
    ("Device DoubleArray", 0x2990): lambda _b, _r: [end for span in SPANS for end in (-span, span)],
    ("Device DoubleArray", 0x299B): _always([-10.0, 10.0]),
    ("Task String", 0x1276): lambda _b, request: request.task.name,
    ("Task UInt32", 0x2181): _task(lambda task: len(task.names)),
    ("Chan Double", 0x182C): _always(float(BITS)),
    ("Timing Double", 0x1344): _task(lambda task: task.rate),
    ("Read UInt32", 0x1223): lambda board, request: board.waiting(board.task(request.task.name)),
    ("Read UInt64", 0x1221): _task(lambda task: task.read),
}
"""Attributes: object and type, as in the name of the call, and number."""
CALLS: dict[str, Callable[..., Answer]] = {
    **{name: _attribute(name) for name in {"Get" + of.replace(" ", "Attribute") for of, _ in ATTRIBUTES}},
    "CreateTask": lambda server, request, context, _fault: server.create_task(request, context),
    "ClearTask": _of_task(lambda board, _task, request: board.tasks.pop(request.task.name)),
    "StartTask": _of_task(lambda board, task, _request: board.start(task)),
    "StopTask": _of_task(_stop),
    "TaskControl": _of_task(lambda board, task, request: board.control(task, request.action_raw)),
    "CreateAIVoltageChan": _of_task(
        lambda b, t, r: b.add_input(t, r.physical_channel, r.terminal_config_raw, r.min_val, r.max_val)
    ),
    "CreateAOVoltageChan": _of_task(_add_output),
    "CreateDIChan": _of_task(lambda board, task, request: board.add(task, "di", request.lines, DI)),
    "CreateDOChan": _of_task(lambda board, task, request: board.add(task, "do", request.lines, DO)),
    "CfgSampClkTiming": _of_task(_configure),
    "ReadAnalogF64": lambda server, request, _context, _fault: server.read(request),
    "ReadDigitalLines": lambda server, request, _context, _fault: server.read_line(request),
    "IsTaskDone": lambda server, request, _c, _f: {"is_task_done": server.board.task(request.task.name).done},
    "WriteAnalogScalarF64": EmulatedServer.write,
    "WriteDigitalLines": EmulatedServer.write_line,
}
"""The supported calls; any other is refused as unknown."""
