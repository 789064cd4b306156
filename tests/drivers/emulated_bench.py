"""A shipped bench on ports of its own, `pmabench emulate` as a process, and its control socket."""

import json
import os
import re
import socket
import subprocess
import sys
from contextlib import contextmanager, suppress

from pmabench.files.shipped import shipped_folder
from tests.ports import free_port


def own_bench(tmp_path, name, *changes, session=False):
    """A shipped bench with ports and links of its own and, where not asked for, without its session, after `changes` (old, new) to its text.

    Every port on 127.0.0.1 and every link in a folder /tmp/pmabench-... is another one.
    """
    folder, path = shipped_folder("bench"), tmp_path / f"{name}.yaml"
    text = (folder / path.name).read_text()
    for old, new in changes:
        assert old in text, f"{path.name} has no {old!r}"
        text = text.replace(old, new)
    ports: dict[str, str] = {}
    for found in re.findall(r"(?:127\.0\.0\.1:|_port: )(\d+)", text):
        ports.setdefault(found, str(free_port()))
    for old, new in ports.items():
        text = re.sub(rf"(127\.0\.0\.1:|_port: ){old}\b", rf"\g<1>{new}", text)
    text = re.sub(r"/tmp/pmabench-[\w-]+/", f"{tmp_path / 'ports'}/", text)
    path.write_text(text if session else re.sub(r"\nsession:.*(\n[ #].*)*", "", text))
    for next_to in ("calibrations", "registers"):
        if not (tmp_path / next_to).exists():
            (tmp_path / next_to).symlink_to(folder / next_to)
    return path


@contextmanager
def emulate(path, *options):
    """`pmabench emulate` as a process: the process, and what it says of itself.

    It stands for hardware, which waits for nobody: it has a session of its own (of which Linux gives each its share of
    the processors) and where that is allowed it goes first.
    """
    command = [sys.executable, "-m", "pmabench", "emulate", str(path), "--json", "-q", *options]
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, bufsize=1, start_new_session=True
    )
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process.pid, -10)
    try:
        text = ""
        while not text.endswith("\n}\n"):
            line = process.stdout.readline()
            assert line, process.stderr.read()
            text += line
        yield process, json.loads(text)
        process.terminate()  # a SIGINT is ignored by what a shell started in the background
        assert process.wait(10) == 0
    finally:
        process.kill()
        process.communicate()


def ask(address, **wanted):
    """One object over the control socket of an emulator, and its answer."""
    host, port = address.split(":")
    with socket.create_connection((host, int(port)), timeout=5) as link, link.makefile("rw") as stream:
        stream.write(json.dumps(wanted) + "\n")
        stream.flush()
        return json.loads(stream.readline())
