"""R9: sampling at 500 Hz in real time beside a busy process, against a loop that sleeps relatively. Printed, with -s."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

RATE = 500.0
SECONDS, SHORT = 10.0, 1.0
"""How long it samples [s], and how long where nothing is measured."""
BUSY = "while True: pass"


def sampled(how, seconds):
    """Times of the samples [s] and missed deadlines of a loop in its own process, beside a busy one."""
    busy = subprocess.Popen([sys.executable, "-c", BUSY])
    try:
        command = [sys.executable, Path(__file__).with_name("sampling.py"), how, str(seconds)]
        done = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    finally:
        busy.kill()
        busy.wait()
    return np.array(done["times"]), done["missed"]


@pytest.mark.parametrize("how", ["absolute", pytest.param("relative", marks=pytest.mark.study)])
def test_sampling_at_500_hz(benchmark, how):
    times, missed = benchmark.pedantic(sampled, args=(how, SHORT if benchmark.disabled else SECONDS), rounds=1)
    span = times[-1] - times[0]
    rate = (len(times) - 1) / span
    late = times - times[0] - np.arange(len(times)) / RATE
    if how == "absolute":  # by what no later sample is late: a deadline that was missed shifts all after it
        late -= np.minimum.accumulate(late[::-1])[::-1]
    reported = f"{how}: {rate:.2f} Hz ({100 * (rate / RATE - 1):+.3f} %), {missed} deadlines missed and counted, "
    reported += f"{np.count_nonzero(late > 0.5 / RATE)} kept late, "
    reported += f"lateness p50 {1e3 * np.percentile(late, 50):.2f}, p99 {1e3 * np.percentile(late, 99):.2f} ms, "
    print(reported + f"most {1e3 * late.max():.2f} ms")
    benchmark.extra_info.update(rate=rate, missed=missed, p99=float(np.percentile(late, 99)))
    if how == "absolute":
        kept = (len(times) - 1 + missed) / span
        assert abs(kept / RATE - 1) < 1e-3  # every deadline is either kept, late or in time, or counted
