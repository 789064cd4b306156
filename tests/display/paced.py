"""Records a closed run once more, as slowly as it happened: a live folder for the display without a bench.

`python -m tests.display.paced RUN PARENT [SPEED]` prints the new folder and writes until the run is over.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from pmabench.store.reader import RunFiles, open_run, read_stream
from pmabench.store.writer import RunWriter

WRITTEN_BY_WRITER = ("id", "schema", "versions", "platform", "snapshots", "writer", "sha256")
STEP = 0.05


class Paced:
    """A run that is being written; `advance` goes on to a time of the run."""

    def __init__(self, run, parent, realtime=True):
        data = open_run(run)
        files = RunFiles(Path(run))
        manifest = {k: v for k, v in files.manifest.items() if k not in WRITTEN_BY_WRITER}
        snapshots = {n: files.read(n) for n in files.manifest["snapshots"] if n != "README.txt"}
        if "bench.json" in snapshots:
            snapshots["bench.json"] = json.dumps(json.loads(snapshots["bench.json"]) | {"realtime": realtime}).encode()
        self.writer = RunWriter.create(Path(parent), "paced", manifest, snapshots)
        self.streams = {}
        for name in files.stream_names():
            about = json.loads(files.read(f"streams/{name}.json"))
            self.writer.open_stream(name, about["columns"], about["rate"])
            frame = read_stream(run, name, raw=True)
            self.streams[name] = [frame, 0]
        self.events = list(data.events)
        self.t = 0.0

    @property
    def folder(self):
        return self.writer.folder

    @property
    def length(self):
        return self.events[-1].t

    def advance(self, until):
        """Samples and events up to a time [s], in the order in which an engine writes them."""
        while self.t < until:
            self.t = min(until, self.t + STEP)
            while self.events and self.events[0].t <= self.t and self.events[0].kind != "end":
                event = self.events.pop(0)
                self._samples(event.t if event.kind == "trial-end" else event.t - 1e-9)
                self.writer.event(event.kind, event.t, **event.data)
            self._samples(self.t)

    def _samples(self, until):
        for name, entry in self.streams.items():
            frame, done = entry
            entry[1] = last = int(np.searchsorted(frame["time_ns"].to_numpy(), round(until * 1e9), side="right"))
            if last > done:
                part = frame.iloc[done:last]
                columns = {c: part[c].to_numpy() for c in frame.columns if c not in ("time_ns", "flags")}
                self.writer.append(name, part["time_ns"].to_numpy(), columns, part["flags"].to_numpy())

    def finish(self):
        """Close as the run that is copied was closed."""
        self.advance(self.length)
        end = dict(self.events[-1].data) if self.events and self.events[-1].kind == "end" else {"status": "finished"}
        return self.writer.close(end.pop("status"), end.pop("why", ""), **end)


def main(run, parent, speed=1.0):
    """Write in real time, or `speed` times as fast."""
    paced = Paced(run, parent)
    print(paced.folder, flush=True)
    started = time.monotonic()
    while paced.t < paced.length:
        paced.advance(min(paced.length, (time.monotonic() - started) * speed))
        time.sleep(STEP / 2)
    paced.finish()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *(float(arg) for arg in sys.argv[3:]))
