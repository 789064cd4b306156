"""The run folder as files: names, hashes, atomic writing of small files, lines of events, status.

Standard library only, so that listing runs starts fast.

A run folder may be copied from anywhere. A FIFO in it would block a reader for ever, a link to a device might never
end, and a link out of the folder would show data that are not part of the run: only regular files inside it are opened.

A line of events is `{"seq":3,"t":1.5,"kind":"command","data":{...},"crc":"0a1b2c3d"}`. The crc32 covers the bytes
before `,"crc"` and begins with the value of the line before (0 for the first), so that lines form a chain.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import secrets
import stat
import sys
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from io import BufferedReader
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, RecordError, invalid, reading

KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFDIR: "a folder",
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_FLAGS = os.O_RDONLY
for _flag in ("O_BINARY", "O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY"):  # not every system has all of them
    _FLAGS |= getattr(os, _flag, 0)


def kind_of(mode: int) -> str:
    """Kind of file for a mode from `lstat`, in words."""
    return KINDS.get(stat.S_IFMT(mode), "something else than a file")


def is_regular(path: Path) -> bool:
    """Whether `path` is a regular file, not a link to one."""
    with suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file for reading; raises OSError at once for anything else."""
    _refuse(path.lstat().st_mode)  # before it is opened: opening a device may already do something
    fd = os.open(path, _FLAGS)
    try:
        _refuse(os.fstat(fd).st_mode)
        return os.fdopen(fd, "rb")
    except OSError:
        os.close(fd)
        raise


def open_inside(folder: Path, name: str) -> BufferedReader:
    """Open the file `name` (`/` between folders) of a run folder; OSError as `open_regular`, or if it lies outside."""
    place = folder
    parts = name.split("/")
    if not {"", ".", ".."}.isdisjoint(parts):
        raise OSError(errno.EINVAL, "its name leads out of the folder")
    for part in parts[:-1]:
        place /= part
        if place.is_symlink():
            raise OSError(errno.ELOOP, f"{part}/ is a link, and links are not followed")
    return open_regular(folder / name)


def sha256_of(path: Path) -> str:
    """Hash of a regular file's bytes; raises OSError as `open_regular`."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _refuse(mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, f"it is {kind_of(mode)}, and only files are read")


def fault_of(folder: Path, name: str, digest: str, size: int | None = None) -> str:
    """What is wrong with a file of a run, compared with its known hash and size; empty if it is unchanged."""
    path = folder / name
    if not os.path.lexists(path):
        return "is missing"
    if not is_regular(path):
        return odd(path)
    try:
        with open_inside(folder, name) as file:
            same = size in {None, os.fstat(file.fileno()).st_size}
            unchanged = same and hashlib.file_digest(file, "sha256").hexdigest() == digest
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    return "" if unchanged else "was changed: its sha256 does not fit"


def odd(path: Path) -> str:
    """End of a sentence about a path that should be a regular file and is not: "is a link, which ..."."""
    return f"is {kind_of(path.lstat().st_mode)}, which no run contains"


PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")


def run_name(utc: datetime, specimen: str, kind: str, simulated: bool) -> str:
    """A folder name of `[A-Za-z0-9._-]` only that sorts by time.

    For instance `20261121-1432_MAS20-A017_contraction-relaxation_7f3a`; simulated runs have `SIMULATED` before the last
    part, which is random and distinguishes runs of the same minute.
    """
    parts = [utc.astimezone(UTC).strftime("%Y%m%d-%H%M"), _word(specimen, "specimen"), _word(kind, "run")]
    return "_".join([*parts, *(["SIMULATED"] if simulated else []), secrets.token_hex(2)])


def is_run_name(name: str) -> bool:
    """Whether a name has the form of `run_name`."""
    return re.fullmatch(r"\d{8}-\d{4}_[A-Za-z0-9._-]+_[0-9a-f]{4}", name) is not None


def _word(text: str, otherwise: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", text)[:40].strip("-.") or otherwise


def check_name(name: str) -> str:
    """`name` unchanged if it stays inside the run folder and is legal on every file system; else RecordError."""
    if not all(PLAIN_NAME.fullmatch(part) for part in name.split("/")):
        raise RecordError(f'"{name}" cannot be a file of a run; use letters, digits, ".", "_" and "-", and no blank')
    return name


RUN_SCHEMA = "pmabench.run/1"
SEAL_SCHEMA = "pmabench.seal/1"
MANIFEST = "manifest.json"
EVENTS = "events.jsonl"
PLAN = "plan.json"
SEAL = "seal.json"
README = "README.txt"
STREAMS = "streams"
GUARD = "guard.json"
"""File that states how the guard vented the bench after the recording program had died; not in every run."""
LATE = ".late"
"""Suffix of the folder next to a run folder, for files written after the seal, such as `guard.json`."""
LARGEST = 1 << 26
"""Largest size of a manifest, a seal or a head of notes that is read [bytes]."""
NOTES, NOTES_HEAD = "notes", "notes.json"
"""Folder and head file of notes added after the run, outside the sealed part and with separate hashes."""

STATUSES = ("finished", "failed", "aborted", "tripped", "error")
"""Final statuses that a run can record itself; readers report `interrupted` for one whose writer died."""

_HASH_TAIL = b'"\n}\n'
_NO_HASH = b"0" * 64


def newest_run(place: Path) -> Path | None:
    """The run folder in `place` that began last; None without one."""
    begun = []
    for path in place.glob(f"*/{MANIFEST}"):
        with suppress(OSError):
            begun.append((path.stat().st_mtime, path.parent))
    return max(begun)[1] if begun else None


def plain(value: Any) -> Any:
    """`value` converted for JSON: numpy numbers and arrays to numbers and lists, NaN and infinity to null."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, dict | Mapping):  # of a dict the second takes several times as long
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return str(value)


def sealed_json(data: Mapping[str, Any]) -> bytes:
    """JSON text whose last entry `sha256` is the hash of the whole text with 64 zeros in place of the hash."""
    body = json.dumps(plain(data), indent=1, sort_keys=True, ensure_ascii=False).encode()
    head = body[:-2] + b',\n "sha256": "'
    digest = hashlib.sha256(head + _NO_HASH + _HASH_TAIL).hexdigest().encode()
    return head + digest + _HASH_TAIL


def open_json(raw: bytes, path: object) -> dict[str, Any]:
    """The data of a text from `sealed_json`; raises InvalidFile where any byte was changed or is missing."""
    digest, blank = raw[-68:-4], raw[:-68] + _NO_HASH + raw[-4:]
    if len(raw) < 80 or hashlib.sha256(blank).hexdigest().encode() != digest:
        raise invalid(path, "is empty" if not raw else "is damaged or was changed: its own hash does not fit")
    try:
        data = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise invalid(path, "is not JSON") from error
    if not isinstance(data, dict):
        raise invalid(path, "holds no JSON object")
    return data


def read_file(folder: Path, name: str, most: int | None = None) -> bytes:
    """The bytes of a file of the run, at most `most`; raises InvalidFile with the reason if it cannot be read."""
    try:
        with reading(folder / name), open_inside(folder, name) as file:
            return file.read(-1 if most is None else most)
    except (MemoryError, OverflowError) as error:
        raise invalid(folder / name, "cannot be read: it is larger than the memory of this computer") from error


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest; raises InvalidFile for what is not a run, is damaged, or was written by a newer pmabench."""
    if not folder.is_dir() or not (folder / MANIFEST).exists():
        why = "there is no such folder" if not folder.exists() else f"no {MANIFEST} in it"
        if folder.exists() and folder.name.endswith(LATE):
            why = f"it holds what the guard reported late; the run is {folder.name.removesuffix(LATE)}, next to it"
        raise invalid(folder, f"is not a run folder: {why}")
    raw = read_file(folder, MANIFEST, LARGEST)
    newer = re.search(rb'^ "schema": "pmabench\.run/(\d+)"', raw, re.MULTILINE)
    if newer and (version := int(newer[1])) > 1:
        raise invalid(folder, f"was written by a newer pmabench (pmabench.run/{version}); this one reads {RUN_SCHEMA}")
    manifest = open_json(raw, folder / MANIFEST)
    if manifest.get("schema") != RUN_SCHEMA:
        raise invalid(folder / MANIFEST, f"has the schema {manifest.get('schema')!r}, not {RUN_SCHEMA}")
    return manifest


def next_to(path: Path, name: str) -> Iterator[Path]:
    """Folders next to `path` that contain the run `name`: first the one of that name, then renamed ones."""
    parent = path.resolve().parent
    named = [parent / name] if Path(name).name == name else []
    for folder in [*named, *sorted(parent.iterdir())]:
        with suppress(InvalidFile):
            if (folder / MANIFEST).is_file() and read_manifest(folder).get("id") == name:
                yield folder


def read_seal(folder: Path) -> dict[str, Any] | None:
    """The seal of a closed run, or None where there is none; raises InvalidFile where it is damaged."""
    if not os.path.lexists(folder / SEAL):
        return None
    seal = open_json(read_file(folder, SEAL, LARGEST), folder / SEAL)
    if seal.get("schema") != SEAL_SCHEMA or not isinstance(seal.get("files"), dict):
        raise invalid(folder / SEAL, f"has the schema {seal.get('schema')!r}; this pmabench reads {SEAL_SCHEMA}")
    for name, entry in seal["files"].items():
        entry = entry if isinstance(entry, dict) else {}
        if not (isinstance(entry.get("sha256"), str) and isinstance(entry.get("bytes"), int)):
            raise invalid(folder / SEAL, f'does not say the sha256 and the bytes of "{name}"')
    return seal


def status_of(manifest: Mapping[str, Any], seal: Mapping[str, Any] | None) -> str:
    """The status in the seal; without a seal `running` while the writer process exists, else `interrupted`."""
    if seal is not None:
        return str(seal.get("status", "interrupted"))
    return "running" if _alive(manifest.get("writer") or {}) else "interrupted"


def this_process() -> dict[str, Any]:
    """Data that identify this process on this machine, even after a reboot; empty without Linux's /proc."""
    fields = _process(os.getpid())
    return {"pid": os.getpid(), "started": fields[1], "boot": _boot()} if fields else {}


def _alive(writer: Mapping[str, Any]) -> bool:
    state, started = _process(writer.get("pid")) or ("X", 0)
    return state not in "ZX" and started == writer.get("started") and _boot() == writer.get("boot")


def _process(pid: object) -> tuple[str, int] | None:
    """State letter and start time [clock ticks since boot] of a process; None where unknown."""
    with suppress(OSError, ValueError, IndexError):
        if isinstance(pid, int) and pid > 0:
            fields = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
            return fields[0], int(fields[19])
    return None


@cache
def _boot() -> str:
    with suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    return ""


def files_of(folder: Path) -> Iterator[tuple[str, Path]]:
    """Every file (and link) below the run folder, as (name inside the run, path), sorted. Raises OSError."""

    def fail(error: OSError) -> None:
        raise error

    found = []
    for base, folders, names in os.walk(folder, onerror=fail):
        linked = [name for name in folders if (Path(base) / name).is_symlink()]
        found += [Path(base) / name for name in [*names, *linked]]
    for path in sorted(found):
        yield path.relative_to(folder).as_posix(), path


def cannot_write(path: Path, error: BaseException) -> RecordError:
    """The error for a failed write."""
    return RecordError(f"cannot write {path}: {reason_of(error)}; the run is not fully recorded")


def reason_of(error: BaseException) -> str:
    """Reason for a failed write in the operating system's words, without those that Arrow adds."""
    reason = str(getattr(error, "strerror", None) or error or type(error).__name__)
    number = getattr(error, "errno", None)
    return os.strerror(number) if number and "[errno" in reason else reason


def part_of(path: Path) -> Path:
    """The hidden temporary file that is renamed to `path` when it is complete."""
    return path.with_name(f".{path.name}.part")


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Gives a hidden file to write, then renames it to `path`; after an error it is removed. Raises OSError."""
    part = part_of(path)
    try:
        yield part
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise
    sync_folder(path.parent)


def write_whole(path: Path, content: bytes) -> None:
    """Write a small file atomically (complete or not at all) and synced. Raises OSError."""
    with whole(path) as part, part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


@dataclass(frozen=True)
class Copy:
    """A file to be copied into a run unchanged, without loading it into memory."""

    path: Path
    sha256: str
    """Expected hash; a file that was changed is not copied."""


def copy_file(source: Path, target: Path) -> tuple[str, int]:
    """Copy a file, synced; returns sha256 and size [bytes] of the copied data. Raises OSError."""
    digest = hashlib.sha256()
    with source.open("rb") as old, target.open("wb") as new:
        while piece := old.read(1 << 22):
            digest.update(piece)
            new.write(piece)
        new.flush()
        os.fsync(new.fileno())
        return digest.hexdigest(), new.tell()


def copy_whole(path: Path, source: Copy) -> None:
    """Copy a file atomically (complete or not at all) and synced.

    Raises OSError, or InvalidFile where the source does not have the expected hash.
    """
    with whole(path) as part:
        if copy_file(source.path, part)[0] != source.sha256:
            raise invalid(source.path, "was changed while it was read")


def sync_folder(folder: Path) -> None:
    """Make new and renamed entries of a folder survive a power cut, where the system can do that."""
    if sys.platform == "win32":
        return
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


@dataclass
class AppendFile:
    """A file that grows by complete pieces: a failed piece is truncated away, so that it can be written again."""

    path: Path
    size: int = 0
    _fd: int = -1

    def open(self) -> AppendFile:
        """Create the file, which must not exist. Raises OSError."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
        self._fd = os.open(self.path, flags, 0o644)
        return self

    def write(self, piece: bytes) -> None:
        """Hand `piece` to the operating system, all of it or none. Raises OSError."""
        os.lseek(self._fd, self.size, os.SEEK_SET)
        rest = memoryview(piece)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._fd, self.size)
            raise
        self.size += len(piece)

    def sync(self) -> None:
        """Sync, so that the written data survive a power cut. Raises OSError, also if the file was moved or deleted."""
        (os.fdatasync if sys.platform == "linux" else os.fsync)(self._fd)
        if not os.path.samestat(os.fstat(self._fd), self.path.stat()):
            raise FileNotFoundError(errno.ENOENT, "another file is in its place")

    def close(self) -> None:
        """Close the file; may be called again."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)


def encode_line(seq: int, t: float, kind: str, data: Mapping[str, Any], before: int) -> tuple[bytes, int]:
    """One line of events, and its crc, which the next line needs as `before`."""
    entry = {"seq": seq, "t": round(float(t), 9), "kind": kind, "data": plain(data)}
    body = json.dumps(entry, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()[:-1]
    crc = zlib.crc32(body, before)
    return body + b',"crc":"%08x"}\n' % crc, crc


@dataclass(frozen=True)
class Journal:
    """The lines before the first invalid one, and what is wrong with that (empty: all lines are valid)."""

    lines: tuple[dict[str, Any], ...]
    fault: str = ""


def decode_lines(raw: bytes, seq: int = 0, crc: int = 0) -> Journal:
    """All valid lines up to the first invalid one.

    If `raw` continues lines that were read before, `seq` is their number and `crc` the value of the last of them.
    """
    lines: list[dict[str, Any]] = []
    for number, line in enumerate(raw.split(b"\n"), start=1):
        if not line and number > raw.count(b"\n"):
            break
        body, mark, tail = line.rpartition(b',"crc":"')
        crc = zlib.crc32(body, crc)
        if not mark or tail != b'%08x"}' % crc:
            torn = number > raw.count(b"\n")
            return Journal(tuple(lines), f"line {number} is {'torn' if torn else 'altered'}: its crc32 does not fit")
        try:
            entry = json.loads(body + b"}")
        except (ValueError, RecursionError):
            return Journal(tuple(lines), f"line {number} is not JSON")
        if entry.get("seq") != seq + len(lines) or not {"t", "kind", "data"} <= entry.keys():
            return Journal(tuple(lines), f"line {number} should have seq {seq + len(lines)}")
        lines.append(entry)
    return Journal(tuple(lines))


def journal_summary(manifest: Mapping[str, Any], journal: Journal, spans: list[tuple[float, float]]) -> dict[str, Any]:
    """Trials planned and finished, and the duration [s] from the first to the last sample or event.

    Repeated reference trials do not count.
    """
    ends = [line["data"] for line in journal.lines if line["kind"] == "trial-end"]
    begins = [line["data"] for line in journal.lines if line["kind"] == "trial-begin"]
    again = {begin.get("trial") for begin in begins if begin.get("again")}
    begun = {begin.get("trial") for begin in begins} - again
    times = [line["t"] for line in journal.lines] + [t for span in spans for t in span]
    return {
        "trials_planned": max(int(manifest.get("trials_planned") or 0), len(begun)),
        "trials_finished": len({end.get("trial") for end in ends if end.get("status") == "finished"} - again),
        "duration": max(times) - min(times) if times else None,
    }
