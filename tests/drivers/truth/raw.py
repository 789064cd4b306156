"""Clients written from the devices' manuals, with conversions from data sheets: they share no code with the project.

Each takes the addresses of a rig and gives one channel in SI.
"""

import contextlib
import os
import select
import socket
import struct
import time
from binascii import crc_hqx


def modbus(address, start, count, function=3):
    """Registers over Modbus TCP, as bytes."""
    host, port = address.rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=2) as link:
        link.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, function, start, count))
        answer = b""
        while len(answer) < 9 + 2 * count:
            piece = link.recv(300)
            assert piece, answer
            answer += piece
    assert answer[7] == function, answer
    return answer[9:]


class Line:
    """A serial port that is opened as a file."""

    def __init__(self, path):
        self._file = os.open(path, os.O_RDWR | os.O_NOCTTY)

    def send(self, text):
        os.write(self._file, text.encode())

    def take(self, seconds=0.1):
        """What comes within so long."""
        data, end = b"", time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            if select.select([self._file], [], [], left)[0]:
                data += os.read(self._file, 4096)
        return data

    def close(self):
        os.close(self._file)


@contextlib.contextmanager
def line(path):
    port = Line(path)
    try:
        yield port
    finally:
        port.close()


def festo(at):
    """CPX-E-4AI-UI on place 3, channel 0: Festo's own test has the module at 45399; 32000 counts are 10 V, 10 bar."""
    [count] = struct.unpack(">h", modbus(at["terminal"], 45399, 1))
    return count / 32000 * 10e5


def festo_sine(at):
    """Telegram 111: the position is after five words, low word first; the user unit is 1 um."""
    low, high = struct.unpack(">HH", modbus(at["drive"], 105, 2))
    return struct.unpack(">i", struct.pack(">HH", high, low))[0] * 1e-6


def labjack(at):
    """AIN0 is the float at register 0; the transmitter gives 1 V a bar from -0.5 bar."""
    [volts] = struct.unpack(">f", modbus(at["t7"], 0, 2))
    return (volts - 0.5) * 1e5


def labjack_t8(at):
    """AIN2 is the float at register 4; 5 mV/N and 0.25 V without load."""
    [volts] = struct.unpack(">f", modbus(at["t8"], 4, 2))
    return (volts - 0.25) / 0.005


def ni(at):
    """ai2 by the messages of NI's gRPC server, range 10 V; 5 mV/N and 0.25 V without load."""
    import grpc
    from nidaqmx._stubs import nidaqmx_pb2

    with grpc.insecure_channel(at["daq"]) as channel:

        def call(name, **fields):
            request = getattr(nidaqmx_pb2, f"{name}Request")(**fields)
            ask = channel.unary_unary(
                f"/nidaqmx_grpc.NiDAQmx/{name}",
                request_serializer=lambda message: message.SerializeToString(),
                response_deserializer=getattr(nidaqmx_pb2, f"{name}Response").FromString,
            )
            return ask(request, timeout=5)

        call("CreateTask", session_name="raw")
        task = {"name": "raw"}
        call(
            "CreateAIVoltageChan",
            task=task,
            physical_channel="Dev1/ai2",
            terminal_config_raw=10083,
            min_val=-10.0,
            max_val=10.0,
            units_raw=10348,
        )
        call(
            "CfgSampClkTiming", task=task, rate=100.0, active_edge_raw=10280, sample_mode_raw=10123, samps_per_chan=100
        )
        call("StartTask", task=task)
        time.sleep(0.1)
        read = call("ReadAnalogF64", task=task, num_samps_per_chan=1, timeout=1.0, array_size_in_samps=1)
        call("ClearTask", task=task)
    return (read.read_array[0] - 0.25) / 0.005


def can(at):
    """Object 6020h:1 of node 12 over slcan, in steps of 6005h:1 (0.001 um); 5 mm are drawn at rest."""
    host, port = at["bus"].rsplit("/", 1)[1].split(":")
    with socket.create_connection((host, int(port)), timeout=2) as link:

        def upload(index, sub):
            question = struct.pack("<BHB4x", 0x40, index, sub)
            link.sendall(f"t60C8{question.hex().upper()}\r".encode())
            data, end = b"", time.monotonic() + 2
            while time.monotonic() < end:
                data += link.recv(4096)
                for text in data.split(b"\r"):
                    if text.startswith(b"t58C8") and len(text) >= 21:
                        return struct.unpack("<i", bytes.fromhex(text[13:21].decode()))[0]
            raise AssertionError(data)

        link.sendall(b"S6\rO\r")
        return upload(0x6020, 1) * upload(0x6005, 1) * 1e-9 - 0.005


def laser(at):
    """ILD1420 of 100 mm: 18 bits in three bytes, 65520 for 102 % of the range from -1 %; 5 mm at rest."""
    with line(at["laser"]) as port:
        port.send("OUTPUT RS422\r")
        data = port.take(0.2)
        port.send("OUTPUT NONE\r")
    data = data[data.index(b"->") + 2 :]
    first = next(i for i in range(len(data) - 2) if [byte >> 6 for byte in data[i : i + 3]] == [0, 1, 2])
    low, middle, high = (byte & 0x3F for byte in data[first : first + 3])
    code = low | middle << 6 | high << 12
    return ((102 / 65520 * code - 1) / 100 * 100 - 5) * 1e-3


def board(at):
    """The open line protocol: a1 of a sample, 4092 counts at 5 V, 95 mm over 5 V from -5 mm."""

    def framed(text):
        return f"{text}*{crc_hqx(text.encode(), 0xFFFF):04X}\n"

    with line(at["board"]) as port:
        port.send(framed("G,1,10000"))
        lines = port.take(0.2).split(b"\n")
        port.send(framed("G,2,0"))
    sample = next(text for text in lines if text.startswith(b"S,")).partition(b"*")[0].split(b",")
    return (int(sample[5]) / 4092 * 95 - 5) * 1e-3


def alicat(at):
    """The data frame: unit id, gauge pressure and set-point in kPa."""
    with line(at["controller"]) as port:
        port.send("A\r")
        return float(port.take(0.2).split()[1]) * 1e3


def dataq(at):
    """a1 of a DI-2108: 16 bit, 10 V full scale, low byte first; 200 N a volt."""
    with line(at["daq"]) as port:
        for command in ("stop", "slist 0 1", "srate 60000", "ps 0"):
            port.send(f"{command}\r")
            assert command.encode() in port.take(0.1)
        port.send("start 0\r")
        data = port.take(0.3)
        port.send("stop\r")
    return struct.unpack("<h", data[:2])[0] / 32768 * 10 * 200


def load_cell(at):
    """An indicator that answers "P" with, for instance, "ST,+00058.86 N"."""
    with line(at["load_cell"]) as port:
        port.send("P\r")
        return float(port.take(0.2).decode().split(",")[1].split()[0])


CLIENTS = {
    "festo": (festo, "terminal", "pressure"),
    "festo-sine": (festo_sine, "drive", "displacement"),
    "labjack": (labjack, "t7", "pressure"),
    "labjack-t8": (labjack_t8, "t8", "force"),
    "ni": (ni, "daq", "force"),
    "can": (can, "bus", "displacement"),
    "serial": (laser, "laser", "displacement"),
    "serial-line-daq": (board, "board", "displacement"),
    "alicat": (alicat, "controller", "pressure"),
    "dataq": (dataq, "daq", "force"),
    "wires": (load_cell, "load_cell", "force"),
}
"""Shipped bench -> its raw client, the device that is asked, the quantity."""
