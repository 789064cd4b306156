"""TDMS files, read by npTDMS: channels as `group/channel`, and the time of a group as `group/@time`."""

from __future__ import annotations

import io
import logging
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import Any, Literal

import numpy as np

from pmabench.base.errors import invalid
from pmabench.store.formats.record import TIME, TOGETHER, Column, Format, Layout, Recorded, begins, damaged, numbers

MAGIC = b"TDSm"


class TdmsLayout(Layout):
    """TDMS, with the scales that the file holds."""

    format: Literal["tdms"]


def read_tdms(path: str, content: bytes, layout: TdmsLayout | None, only: Collection[str] | None) -> Recorded:
    """The channels of numbers in `only` (None: all); raises InvalidFile.

    Values are scaled with the file's own scales, as in other programs. `group/@time` [s] comes from `wf_increment` if
    all channels of a group have the same and start together. Time stamps count from the first one.
    """
    if not content.startswith(MAGIC):
        raise invalid(path, f'is no TDMS file: it does not begin with "{MAGIC.decode()}"')
    from nptdms import TdmsFile

    ends = _end(content)
    recorded = Recorded([])
    with damaged(path, "TDMS"), _warnings(recorded), TdmsFile.open(io.BytesIO(content)) as file:
        if getattr(file.file_status, "incomplete_final_segment", False):
            recorded.cut_end = True
            recorded.doubts.append("the last segment is incomplete: the recording was cut off")
        if ends is not None and ends != len(content):
            text = f"the segments end at byte {ends}, the file at byte {len(content)}: bytes were lost or put in"
            recorded.doubts.append(text)
        for group in file.groups():
            _group(path, recorded, group, only)
        return recorded


@contextmanager
def _warnings(recorded: Recorded) -> Iterator[None]:
    """Turn warnings that npTDMS logs into doubts."""

    class Doubts(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            recorded.doubts.append(record.getMessage()[:200])

    logger, handler = logging.getLogger("nptdms"), Doubts(logging.WARNING)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def _end(content: bytes) -> int | None:
    """End of the last segment [bytes] from the lengths in the segment heads; None if the last length was never written.

    A head is 28 bytes: TDSm, mask, version, length of the rest of the segment, length of the metadata.
    """
    at = 0
    while at + 28 <= len(content):
        if content[at : at + 4] != MAGIC:
            return at
        order: Any = "big" if content[at + 4] & 0x40 else "little"
        length = int.from_bytes(content[at + 12 : at + 20], order)
        if length == 2**64 - 1:
            return None
        at += 28 + length
    return at


def _group(path: str, recorded: Recorded, group: Any, only: Collection[str] | None) -> None:
    times: set[tuple[float, int]] = set()
    starts: list[float] = []
    zero: np.datetime64 | None = None
    for channel in group.channels():
        name, found = f"{group.name}/{channel.name}", channel.properties
        if len(channel) == 0:
            continue
        step = found.get("wf_increment")
        begin = found.get("wf_start_offset", 0.0)
        stamp = found.get("wf_start_time")
        if isinstance(step, float) and isinstance(begin, float):
            times.add((step, len(channel)))
            stamped = isinstance(stamp, np.datetime64)
            zero = zero if zero is not None or not stamped else stamp
            starts.append(begin + (float((stamp - zero) / np.timedelta64(1, "ns")) * 1e-9 if stamped else 0.0))
        if recorded.started is None and isinstance(stamp, np.datetime64):
            recorded.started = stamp.astype("datetime64[us]").astype(datetime)
        if only is not None and name not in only:
            recorded.left_out.append(name)
            continue
        values = np.asarray(channel[:])
        unit = found.get("unit_string") or found.get("NI_UnitDescription") or ""
        if values.dtype.kind == "M":
            since = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
            recorded.columns.append(Column(name, np.asarray(since, dtype=np.float64), "s"))
            continue
        column = numbers(values)
        if column is None:
            recorded.left_out.append(name)
        else:
            recorded.columns.append(Column(name, column, unit if isinstance(unit, str) else ""))
    name = f"{group.name}/{TIME}"
    apart = max(starts, default=0.0) - min(starts, default=0.0)
    step, count = times.pop() if len(times) == 1 else (0.0, 0)
    if not (step > 0 and np.isfinite([step, *starts]).all()):
        return
    if apart > TOGETHER * step:
        text = f'the channels of "{group.name}" begin up to {apart:.3g} s apart (wf_start_time, wf_start_offset)'
        if only is not None and name in only:
            raise invalid(path, f"{text}: they have no clock in common; put them on one before you export them")
        recorded.doubts.append(f"{text}: their rows are of other moments")
    elif only is None or name in only:
        recorded.columns.append(Column(name, starts[0] + np.arange(count, dtype=np.float64) * step, "s"))


FORMAT = Format("tdms", "TDMS", TdmsLayout, begins(MAGIC), read_tdms, modules=("nptdms",), package="npTDMS")
