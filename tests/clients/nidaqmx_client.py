"""NI's own package `nidaqmx`, unmodified, over gRPC in front of a USB-6215: the calls that the driver makes.

Calls: the README of the package, https://github.com/ni/nidaqmx-python (1.7.0: Key Concepts, Timing, Usage), its stream
readers and writers, with `grpc_options` as NI's example grpc_device/... adds them; an example of ni/nidaqmx-python at
that version: cont_voltage_acq_int_clk.
"""

import sys
import time

import grpc
import nidaqmx
import nidaqmx.system
import numpy as np
from nidaqmx.constants import AcquisitionType, TerminalConfiguration
from nidaqmx.errors import DaqError
from nidaqmx.stream_readers import AnalogMultiChannelReader, DigitalSingleChannelReader
from nidaqmx.stream_writers import AnalogSingleChannelWriter, DigitalSingleChannelWriter
from said import call, not_tried

wire = grpc.insecure_channel(sys.argv[1])
V0, V1 = 0.5, 0.5
"""What ai0 (pressure) and ai1 (displacement) give while nothing is pressurised and nothing hangs [V]."""
NEAR = 0.02


def task():
    """A task as on the page, on the server."""
    return nidaqmx.Task(grpc_options=nidaqmx.GrpcSessionOptions(wire, ""))


with call("Task()"), task():
    pass
with call("timing.cfg_samp_clk_timing(CONTINUOUS), AnalogMultiChannelReader.read_many_sample") as saw, task() as made:
    made.ai_channels.add_ai_voltage_chan(
        "Dev1/ai0", terminal_config=TerminalConfiguration.RSE, min_val=-5.0, max_val=5.0
    )
    made.ai_channels.add_ai_voltage_chan("Dev1/ai1", min_val=-10.0, max_val=10.0)
    assert made.number_of_channels == 2
    made.timing.cfg_samp_clk_timing(1000.0, sample_mode=AcquisitionType.CONTINUOUS, samps_per_chan=1000)
    assert abs(made.timing.samp_clk_rate - 1000.0) < 1.0
    made.start()
    reader = AnalogMultiChannelReader(made.in_stream)
    reader.verify_array_shape = False
    data = np.full((2, 100), np.nan)
    for _ in range(3):
        assert reader.read_many_sample(data, 100) == 100
        assert np.all(np.abs(data - [[V0], [V1]]) <= NEAR), data[:, -1]
    assert made.in_stream.curr_read_pos == 300
    time.sleep(0.1)
    assert made.in_stream.avail_samp_per_chan > 20
    assert not made.is_task_done()
    made.stop()
    saw["pressure"], saw["displacement"] = 1e5 * data[0, -1] - 50e3, 0.01 * data[1, -1] - 0.005
with call("AnalogSingleChannelWriter.write_one_sample(5.5), (0.0)") as saw, task() as made:
    made.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    writer = AnalogSingleChannelWriter(made.out_stream, auto_start=True)
    writer.write_one_sample(5.5)
    writer.write_one_sample(0.0)
    saw["commanded"] = 0.0
with call("write_one_sample: beyond the range is refused"), task() as made:
    made.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    try:
        AnalogSingleChannelWriter(made.out_stream, auto_start=True).write_one_sample(11.0)
    except DaqError as error:
        assert error.error_code == -200561
    else:
        raise AssertionError("it was not refused")
with call("DigitalSingleChannelWriter.write_one_sample_one_line(True), (False)") as saw, task() as made:
    made.do_channels.add_do_chan("Dev1/port1/line0")
    for level in (True, False):
        DigitalSingleChannelWriter(made.out_stream, auto_start=True).write_one_sample_one_line(level)
        assert DigitalSingleChannelReader(made.in_stream).read_one_sample_one_line() is level
    saw["valve"] = 0.0
with call("DigitalSingleChannelReader.read_one_sample_one_line"), task() as made:
    made.di_channels.add_di_chan("Dev1/port0/line0")
    assert DigitalSingleChannelReader(made.in_stream).read_one_sample_one_line() is True
with call("System.driver_version"):
    system = nidaqmx.system.System.remote(nidaqmx.GrpcSessionOptions(wire, ""))
    assert system.driver_version.major_version >= 20
with call("System.devices"):
    assert [device.name for device in system.devices] == ["Dev1"]
    assert "USB-6215" in system.devices["Dev1"].product_type
with call("Device.ai_physical_chans, ao_physical_chans, di_lines, do_lines, ai_voltage_rngs"):
    device = system.devices["Dev1"]
    assert device.ai_physical_chans.channel_names == [f"Dev1/ai{i}" for i in range(16)]
    assert device.ao_physical_chans.channel_names == ["Dev1/ao0", "Dev1/ao1"]
    assert len(device.di_lines) == len(device.do_lines) == 4
    assert max(device.ai_voltage_rngs) == 10.0
not_tried(
    "Task.read, Task.write, finite tasks, lists of channels, whole ports, counters", "the driver makes no such call"
)
