"""The program `mbpoll` (libmodbus) in front of a register map over TCP: a pressure regulator.

Calls: the examples of its manual page, https://github.com/epsilonrt/mbpoll (README, Help), with this map's addresses.
"""

import re
import subprocess
import sys
import time

from said import call

host, port = sys.argv[1].rsplit(":", 1)


def poll(*options, write=(), fails=""):
    """The numbers that it prints, of one poll."""
    command = ["mbpoll", "-m", "tcp", "-p", port, "-a", "7", "-0", "-1", "-o", "2", *options, host]
    done = subprocess.run([*command, *(["--", *write] if write else [])], capture_output=True, text=True, timeout=20)
    said = done.stdout + done.stderr
    if fails:
        assert fails in said, said
        return []
    assert done.returncode == 0, said
    return [float(text) for text in re.findall(r"^\[\d+\]:\s+(-?[\d.]+)", said, re.MULTILINE)]


with call("read holding registers as 32-bit integers (-t 4:int -B)"):
    assert poll("-t", "4:int", "-B", "-r", "110") == [0x00112233]
with call("read several registers (-t 4:hex -c 2)"):
    command = ["-t", "4:hex", "-r", "110", "-c", "2"]
    assert poll(*command) == [0.0, 0.0]
with call("write a float (-t 4:float -B)") as saw:
    poll("-t", "4:float", "-B", "-r", "10", write=("150",))
    saw["commanded"] = 150e3
with call("read input registers as floats (-t 3:float -B)") as saw:
    poll("-t", "0", "-r", "0", write=("1",))  # the dump valve lets the air through
    time.sleep(2.0)
    [pressure] = poll("-t", "3:float", "-B", "-r", "0")
    assert pressure > 100.0
    saw["pressure"] = 1e3 * pressure
with call("write and read a register (-t 4)"):
    poll("-t", "4", "-r", "20", write=("100",))
    assert poll("-t", "4", "-r", "20") == [100]
    poll("-t", "4", "-r", "20", write=("0",))
with call("write and read a coil (-t 0)") as saw:
    poll("-t", "0", "-r", "0", write=("1",))
    assert poll("-t", "0", "-r", "0") == [1]
    saw["valve"] = 1.0
with call("read a discrete input (-t 1)"):
    assert poll("-t", "1", "-r", "0") == [1]
with call("an address that is not there"):
    poll("-t", "4", "-r", "500", fails="Illegal data address")
