"""A capture file, and a peer that answers from one and says what did not fit.

One line for each run of bytes: time [s], `>` to the device or `<` from it, the bytes as hex, and behind `#` a remark.
"""

import contextlib
import os
import select
import socket
import threading
import tty
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "fixtures" / "captures"
PRINTED = range(0x20, 0x7F)


@dataclass
class Run:
    """Bytes in one direction, at a time."""

    time: float
    to_device: bool
    data: bytes
    line: int = 0


@dataclass
class Capture:
    """Runs of bytes in turn. `whole`: each is a message, and one that is followed by another question had no content."""

    runs: list[Run] = field(default_factory=list)
    whole: bool = False

    def add(self, time, to_device, data):
        """More bytes; those that follow others in the same direction belong to them."""
        if not self.whole and self.runs and self.runs[-1].to_device == to_device:
            self.runs[-1].data += data
        else:
            self.runs.append(Run(time, to_device, data))

    def text(self, about):
        """The file."""
        lines = [f"# {line}" for line in about]
        for run in self.runs:
            sign = ">" if run.to_device else "<"
            said = run.data.decode("ascii", "replace")
            text = all(byte in PRINTED or byte in b"\r\n" for byte in run.data)
            remark = f"  # {said!r}" if text else ""
            lines.append(f"{run.time:7.3f} {sign} {run.data.hex(' ')}{remark}")
        return "\n".join(lines) + "\n"


def read(name):
    """The capture of that name."""
    capture = Capture()
    for number, line in enumerate((FOLDER / f"{name}.txt").read_text().splitlines(), 1):
        content = line.partition("#")[0].split(maxsplit=2)
        if content:
            time, sign, data = content
            assert sign in {">", "<"}, f"{name}:{number}"
            capture.runs.append(Run(float(time), sign == ">", bytes.fromhex(data), number))
    return capture


class Replay:
    """A device that knows one exchange. `wrong` says what was sent that is not in it; `unused` what never came."""

    def __init__(self, capture, path=None):
        self._runs, self.wrong = list(capture.runs), ""
        self._lock, self._ended = threading.Lock(), threading.Event()
        if path is None:
            self._listener = socket.create_server(("127.0.0.1", 0))
            self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        else:
            self._near, self._far = os.openpty()
            tty.setraw(self._far)
            Path(path).symlink_to(os.ttyname(self._far))
            self.address, self._listener = str(path), None
        self._thread = threading.Thread(target=self._accept if path is None else self._talk, daemon=True)
        self._thread.start()

    def close(self):
        self._ended.set()
        if self._listener is not None:
            with contextlib.suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)
            self._listener.close()
        self._thread.join(5)
        if self._listener is None:
            os.close(self._near)
            os.close(self._far)

    @property
    def unused(self):
        """What is left of the exchange, a line each."""
        with self._lock:
            return [f"line {run.line}: {'>' if run.to_device else '<'} {run.data.hex(' ')}" for run in self._runs]

    def call(self, name, data):
        """The answer to a call of gRPC, which a capture holds as its name, a blank and its message; None for none."""
        answers = []
        self._take(name.rpartition("/")[2].encode() + b" " + data, answers.append)
        return answers[0] if answers else None

    def _accept(self):
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection, contextlib.suppress(OSError):
                connection.settimeout(5)
                while not self.wrong and (data := connection.recv(4096)):
                    self._take(data, connection.sendall)

    def _talk(self):
        while not self._ended.is_set():
            if select.select([self._near], [], [], 0.02)[0]:
                self._take(os.read(self._near, 4096), lambda data: os.write(self._near, data))

    def _take(self, data, send):
        with self._lock:
            while data and not self.wrong:
                run = self._runs[0] if self._runs else None
                if run is None:
                    self.wrong = f"after the end came {data.hex(' ')}"
                    return
                wanted, data = data[: len(run.data)], data[len(run.data) :]
                if not run.data.startswith(wanted):
                    self.wrong = f"line {run.line}: {run.data.hex(' ')} was expected, and {wanted.hex(' ')} came"
                    return
                run.data = run.data[len(wanted) :]
                if run.data:
                    return
                self._runs.pop(0)
                answers = []
                while self._runs and not self._runs[0].to_device:
                    answers.append(self._runs.pop(0).data)
                send(b"".join(answers))


class Calls(Replay):
    """The same for a device that is asked through a gRPC server: its messages are told, HTTP/2 is the library's."""

    def __init__(self, capture):
        super().__init__(capture)
        super().close()
        import grpc

        class Every(grpc.GenericRpcHandler):
            def service(_self, details):  # noqa: N805
                return grpc.unary_unary_rpc_method_handler(partial(self._answer, details.method))

        self._server = grpc.server(ThreadPoolExecutor(4), options=[("grpc.so_reuseport", 0)])
        self._server.add_generic_rpc_handlers((Every(),))
        self.address = f"127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        self._server.start()

    def _answer(self, method, data, context):
        import grpc

        answer = self.call(method, data)
        if answer is None:
            context.abort(grpc.StatusCode.INTERNAL, "not in the capture")
        return answer

    def close(self):
        self._server.stop(0.0).wait(2.0)
