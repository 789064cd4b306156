"""NI's own package `nidaqmx`, unmodified, over gRPC in front of a USB-6215.

Calls: the README of the package, https://github.com/ni/nidaqmx-python (1.7.0: Key Concepts, Timing, Usage), in order and
with `grpc_options`, as NI's example grpc_device/... adds them; then examples of ni/nidaqmx-python at that version: voltage_sample,
voltage_acq_int_clk, cont_voltage_acq_int_clk, volt_update, dig_lines/read_dig_lines, write_dig_lines.
"""

import sys

import grpc
import nidaqmx
import nidaqmx.system
from nidaqmx.constants import READ_ALL_AVAILABLE, AcquisitionType, LineGrouping, TerminalConfiguration
from nidaqmx.errors import DaqError
from said import call, not_tried

wire = grpc.insecure_channel(sys.argv[1])
V0, V1, V2 = 0.5, 0.5, 0.25
"""What ai0 (pressure), ai1 (displacement) and ai2 (force) give while nothing is pressurised and nothing hangs [V]."""
NEAR = 0.02


def task():
    """A task as on the page, on the server."""
    return nidaqmx.Task(grpc_options=nidaqmx.GrpcSessionOptions(wire, ""))


def near(found, *wanted):
    """Whether each number is what is wired there."""
    found = found if isinstance(found, list) else [found]
    assert len(found) == len(wanted), f"{len(found)} values instead of {len(wanted)}"
    for value, right in zip(found, wanted, strict=True):
        assert abs(value - right) <= NEAR, f"{value} V instead of {right} V"


with call("Task()"), task():
    pass
with call("read: one channel on demand") as saw, task() as made:
    made.ai_channels.add_ai_voltage_chan("Dev1/ai0", min_val=-10.0, max_val=10.0)
    value = made.read()
    near(value, V0)
    saw["pressure"] = 1e5 * value - 50e3
with call("read: two channels, ranges of their own") as saw, task() as made:
    made.ai_channels.add_ai_voltage_chan("Dev1/ai0", min_val=-5.0, max_val=5.0)
    made.ai_channels.add_ai_voltage_chan("Dev1/ai1", min_val=-10.0, max_val=10.0)
    values = made.read()
    near(values, V0, V1)
    saw["displacement"] = 0.01 * values[1] - 0.005
with call("read: Dev1/ai0:3"), task() as made:
    channel = made.ai_channels.add_ai_voltage_chan("Dev1/ai0:3")
    assert made.number_of_channels == 4
    assert made.channel_names == ["Dev1/ai0", "Dev1/ai1", "Dev1/ai2", "Dev1/ai3"]
    near(made.read(), V0, V1, V2, 0.0)
    rows = made.read(number_of_samples_per_channel=3)
    assert [len(row) for row in rows] == [3, 3, 3, 3]
    near([row[-1] for row in rows], V0, V1, V2, 0.0)
with call("read: a list, Dev1/ai2, Dev1/ai0"), task() as made:
    made.ai_channels.add_ai_voltage_chan("Dev1/ai2, Dev1/ai0")
    near(made.read(), V2, V0)
with call("timing.cfg_samp_clk_timing(FINITE), read(READ_ALL_AVAILABLE)"), task() as made:
    made.ai_channels.add_ai_voltage_chan("Dev1/ai0")
    made.timing.cfg_samp_clk_timing(1000.0, sample_mode=AcquisitionType.FINITE, samps_per_chan=10)
    near(made.read(READ_ALL_AVAILABLE), *[V0] * 10)
not_tried("in_stream.configure_logging, nptdms.TdmsFile", "a file on the server's disk, written by NI-DAQmx itself")
with call("timing.cfg_samp_clk_timing(FINITE), 50 samples of four channels"), task() as made:
    made.ai_channels.add_ai_voltage_chan("Dev1/ai0:3", terminal_config=TerminalConfiguration.RSE)
    made.timing.cfg_samp_clk_timing(1000.0, sample_mode=AcquisitionType.FINITE, samps_per_chan=50)
    made.start()
    made.wait_until_done(timeout=5.0)
    assert made.is_task_done()
    rows = made.read(READ_ALL_AVAILABLE)
    assert [len(row) for row in rows] == [50] * 4
    near([row[0] for row in rows], V0, V1, V2, 0.0)
    made.stop()
with call("read(number_of_samples_per_channel=2)"), task() as made:
    made.ai_channels.add_ai_voltage_chan("Dev1/ai0")
    near(made.read(number_of_samples_per_channel=2), V0, V0)
with call("di_channels.add_di_chan(CHAN_PER_LINE), read(number_of_samples_per_channel=2)"), task() as made:
    made.di_channels.add_di_chan("Dev1/port0/line0:1", line_grouping=LineGrouping.CHAN_PER_LINE)
    assert made.read(number_of_samples_per_channel=2) == [[True, True], [False, False]]
with call("di_channels.add_di_chan(CHAN_FOR_ALL_LINES), read"), task() as made:
    made.di_channels.add_di_chan("Dev1/port0/line0:3", line_grouping=LineGrouping.CHAN_FOR_ALL_LINES)
    assert made.read() == 1
not_tried("co_channels.add_co_pulse_chan_time, write", "counters are not emulated: no bench uses one")
with call("ao_channels.add_ao_voltage_chan, write([1.1 ... 5.5], auto_start=True)") as saw, task() as made:
    made.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    assert made.write([1.1, 2.2, 3.3, 4.4, 5.5], auto_start=True) == 5
    saw["commanded"] = 5.5e5
with call("write(0.0)") as saw, task() as made:
    made.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    assert made.write(0.0) == 1
    saw["commanded"] = 0.0
with call("write: two outputs") as saw, task() as made:
    made.ao_channels.add_ao_voltage_chan("Dev1/ao0:1")
    assert made.write([0.2, 1.0]) == 1
    saw["commanded"] = 0.2e5
with call("write: beyond the range is refused"), task() as made:
    made.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    try:
        made.write(11.0)
    except DaqError as error:
        assert error.error_code == -200561
    else:
        raise AssertionError("it was not refused")
with call("do_channels.add_do_chan(CHAN_PER_LINE), write(True)") as saw, task() as made:
    made.do_channels.add_do_chan("Dev1/port1/line0", line_grouping=LineGrouping.CHAN_PER_LINE)
    assert made.write(True) == 1
    assert made.read() is True
    saw["valve"] = 1.0
with call("do_channels.add_do_chan(CHAN_PER_LINE), write([True, False])"), task() as made:
    made.do_channels.add_do_chan("Dev1/port1/line0:1", line_grouping=LineGrouping.CHAN_PER_LINE)
    assert made.write([True, False]) == 1
    assert made.read() == [True, False]
with call("do_channels.add_do_chan(CHAN_FOR_ALL_LINES), write(0)") as saw, task() as made:
    made.do_channels.add_do_chan("Dev1/port1/line0:3")
    assert made.write(0) == 1
    assert made.read() == 0
    saw["valve"] = 0.0
with call("timing.cfg_samp_clk_timing(CONTINUOUS), read"), task() as made:
    made.ai_channels.add_ai_voltage_chan("Dev1/ai0:1")
    made.timing.cfg_samp_clk_timing(1000.0, sample_mode=AcquisitionType.CONTINUOUS)
    made.start()
    for _ in range(3):
        rows = made.read(number_of_samples_per_channel=100)
        assert [len(row) for row in rows] == [100, 100]
    assert len(made.read(READ_ALL_AVAILABLE)) == 2
    made.stop()
with call("System.driver_version"):
    system = nidaqmx.system.System.remote(nidaqmx.GrpcSessionOptions(wire, ""))
    assert system.driver_version.major_version >= 20
with call("System.devices"):
    assert [device.name for device in system.devices] == ["Dev1"]
    assert "USB-6215" in system.devices["Dev1"].product_type
with call("Device.ai_physical_chans, ao_physical_chans, di_lines, do_lines"):
    device = system.devices["Dev1"]
    assert [channel.name for channel in device.ai_physical_chans] == [f"Dev1/ai{i}" for i in range(16)]
    assert device.ai_physical_chans["ai0"].name == "Dev1/ai0"
    assert device.ao_physical_chans.channel_names == ["Dev1/ao0", "Dev1/ao1"]
    assert len(device.di_lines) == len(device.do_lines) == 4
with call("PhysicalChannel.ai_term_cfgs"):
    wanted = [TerminalConfiguration.RSE, TerminalConfiguration.NRSE, TerminalConfiguration.DIFF]
    assert system.devices["Dev1"].ai_physical_chans["ai0"].ai_term_cfgs == wanted
