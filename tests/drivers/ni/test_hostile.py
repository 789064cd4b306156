"""A server that answers anything: a sentence in time, and no voltage that no converter gives."""

import math
import random
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import grpc
import pytest
from nidaqmx._stubs import nidaqmx_pb2
from pmabench_drivers.ni_daq import NiDaq
from pmabench_drivers.ni_daq.emulated import SERVICE

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.common import timed
from tests.drivers.ni.rigs import daq, rig
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime

BOUND = 10.0
"""No call hangs; opening may take 2 s, and the rest is for a busy machine [s]."""
VALUES = {
    1: lambda rng: rng.choice([0.0, -1.0, 10.0, 1e300, math.nan, math.inf, rng.gauss(0, 100)]),
    4: lambda rng: rng.choice([0, 1, 2**64 - 1, rng.getrandbits(16)]),
    5: lambda rng: rng.choice([0, -200279, -200284, 200010, 2**31 - 1, rng.randrange(-300000, 300000)]),
    8: lambda rng: rng.random() < 0.5,
    9: lambda rng: rng.choice(
        ["", "Dev1", "Dev1/ai0:3, Dev1/ao0", "\0" * 5, "Dev1/port1/line0" * 99, "Dev[1:", "é" * 300]
    ),
    12: lambda rng: rng.randbytes(rng.randrange(20)),
    13: lambda rng: rng.choice([0, 1, 2**32 - 1, rng.getrandbits(12)]),
    14: lambda rng: rng.randrange(4),
}
"""Type of a field of a message -> something that is one."""


def anything(rng, name):
    """An answer to a call: a right message with any contents, or bytes."""
    kind = getattr(nidaqmx_pb2, f"{name}Response", None)
    if kind is None or rng.random() < 0.2:
        return rng.randbytes(rng.randrange(60))
    message = kind()
    for field in message.DESCRIPTOR.fields:
        if field.name == "status" and rng.random() < 0.8:
            continue
        if field.name == "task":
            message.task.name = VALUES[9](rng)
        elif field.is_repeated:
            getattr(message, field.name).extend(VALUES[field.type](rng) for _ in range(rng.randrange(12)))
        else:
            setattr(message, field.name, VALUES[field.type](rng))
    return message.SerializeToString()


class Anything(grpc.GenericRpcHandler):
    """Answers every call of the service; the first ones rightly enough to get further, in some of the cases."""

    def __init__(self):
        self.rng = random.Random(1)
        self.right = {}
        self.wrong = 0.03

    def service(self, details):
        name = details.method.rpartition("/")[2]
        assert details.method.startswith(f"/{SERVICE}/")

        def answer(data, context):
            if self.rng.random() < self.wrong:
                context.set_trailing_metadata((("ni-error", self.rng.choice(["-200088", "x", "", "9" * 40])),))
                context.abort(self.rng.choice(list(grpc.StatusCode)[1:]), "é\0" * 20)
            if name in self.right and self.rng.random() > self.wrong:
                return self.right[name](data, context)
            return anything(self.rng, name)

        return grpc.unary_unary_rpc_method_handler(answer)


@pytest.fixture(name="hostile")
def _hostile():
    handler = Anything()
    server = grpc.server(ThreadPoolExecutor(4), options=[("grpc.so_reuseport", 0)])
    server.add_generic_rpc_handlers((handler,))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield handler, f"127.0.0.1:{port}"
    server.stop(0).wait(5)


def use(device):
    """Open and use a device; whether it opened, and how many calls after that were carried out."""
    good = []
    for call in (
        device.open,
        lambda: device.write("ao0", 1.0),
        lambda: device.switch("port1/line0", on=True),
        lambda: device.level("port0/line0"),
        lambda: device.start(500.0),
        device.collect,
        device.close,
    ):
        took, outcome = timed(call)
        assert took < BOUND
        assert not isinstance(outcome, Exception) or isinstance(outcome, DeviceError), repr(outcome)
        if isinstance(outcome, DeviceError):
            assert "\n" not in str(outcome)
            assert len(str(outcome)) < 900
        good.append(not isinstance(outcome, DeviceError))
    return good[0], sum(good[1:-1])


def test_a_server_that_answers_anything_is_reported_in_a_sentence(hostile):
    _handler, address = hostile
    for _ in range(cases(300) // 2):
        use(NiDaq(daq(server=address), RealClock()))


def test_and_so_is_one_that_begins_well(hostile):
    """Right answers first, so that every later call meets a wrong one too."""
    handler, address = hostile
    handler.wrong = 0.004
    with rig(opened=False) as (_, served, _device), grpc.insecure_channel(served.address) as wire:

        def pass_on(name):
            call = wire.unary_unary(f"/{SERVICE}/{name}")

            def right(data, context):
                try:
                    return call(data, timeout=1.0)
                except grpc.RpcError as error:
                    context.set_trailing_metadata(error.trailing_metadata())
                    context.abort(error.code(), error.details())

            return right

        for name in ("GetSystemInfoAttributeUInt32", "GetSystemInfoAttributeString", "GetDeviceAttributeString",
                     "GetDeviceAttributeDoubleArray", "GetDeviceAttributeDouble", "GetDeviceAttributeUInt32",
                     "GetDeviceAttributeBool", "GetTaskAttributeString", "GetTaskAttributeUInt32", "GetChanAttributeDouble", "CreateTask",
                     "CreateAIVoltageChan", "CreateAOVoltageChan", "CreateDIChan", "CreateDOChan"):  # fmt: skip
            handler.right[name] = pass_on(name)
        opened = []
        for _ in range(cases(300) // 6):
            opened.append(use(NiDaq(daq(server=address), RealClock())))
            served.board.tasks.clear()
        assert sum(good for good, _ in opened) > 10  # the later calls were met
        assert len({number for good, number in opened if good}) > 1


def test_no_sample_is_taken_for_good_that_none_can_be():
    """Answers while it samples are damaged, one after another."""
    rng = random.Random(2)
    with rig() as (_, served, device):
        answer = served._answer

        def damaged(grpc_, name, request, context):
            data = answer(grpc_, name, request, context)
            if not name.startswith(("Read", "GetRead")) or rng.random() < 0.8:
                return data
            if name != "ReadAnalogF64" or rng.random() < 0.5:
                return anything(rng, name)
            message = nidaqmx_pb2.ReadAnalogF64Response.FromString(data)
            message.read_array[rng.randrange(len(message.read_array))] = rng.choice([1e300, math.nan, -math.inf, 15.0])
            return message.SerializeToString()

        served._answer = damaged
        for _ in range(cases(30)):
            timed(lambda: device.start(2000.0))
            times, values = [], []
            deadline = time.monotonic() + 0.15
            while time.monotonic() < deadline:
                _, block = timed(device.collect)
                if isinstance(block, Exception):
                    assert isinstance(block, DeviceError)
                    break
                times += block.time
                for column in block.columns.values():
                    values += column
                time.sleep(0.01)
            assert all(abs(value) <= 12.0 for value in values)
            assert all(earlier < later for earlier, later in pairwise(times))
