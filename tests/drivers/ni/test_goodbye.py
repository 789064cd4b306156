"""A server or proxy that says good-bye with a code that HTTP/2 does not define ends a call, and not the program.

RFC 9113, section 7: unknown error codes must not trigger any special behaviour. See docs/decisions/0013.
"""

import socket
import struct
import subprocess
import sys
import threading
from contextlib import suppress

import pytest

pytestmark = pytest.mark.realtime

SETTINGS = bytes(3) + b"\4\0" + bytes(4)
GOAWAY = (8).to_bytes(3, "big") + b"\7\0" + struct.pack(">III", 0, 0, 3451406434)
OPEN = """
import sys
from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench_drivers.ni_daq import NiDaq
from tests.drivers.ni.rigs import daq
device = NiDaq(daq(server=sys.argv[1]), RealClock())
try:
    device.open()
except DeviceError as error:
    print("said:", error)
"""


def test_a_good_bye_with_an_unknown_code_is_a_sentence():
    served = []

    def serve():
        while True:
            try:
                connection = listener.accept()[0]
            except OSError:
                return
            with connection, suppress(OSError):
                connection.sendall(SETTINGS)
                connection.recv(4096)
                connection.sendall(GOAWAY)
                served.append(True)
                while connection.recv(4096):
                    pass

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, daemon=True).start()
        command = [sys.executable, "-c", OPEN, f"127.0.0.1:{listener.getsockname()[1]}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        listener.shutdown(socket.SHUT_RDWR)
    assert served
    assert done.returncode == 0, done.stderr[-1000:]
    assert "said: daq:" in done.stdout
