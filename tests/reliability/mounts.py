"""Where tests may mount file systems: root, with loop devices; elsewhere they are not run, and say so."""

import os
import shutil
import subprocess
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

ISOLATED = ("unshare", "-m")
"""Mounts of a command that begins so end with it."""


def need_loop_mounts():
    """Skip the test where an ext4 image cannot be mounted."""
    with fast_folder() as folder:
        script = "truncate -s 4M i && mkfs.ext4 -qF i && mkdir m && mount -o loop i m && umount m"
        if not _works(script, folder):
            pytest.skip("not run: loop mounts (needs root, mkfs.ext4 and loop devices)")


def need_tmpfs():
    """Skip the test where a tmpfs cannot be mounted."""
    with fast_folder() as folder:
        if not _works("mkdir m && mount -t tmpfs -o size=1m none m && umount m", folder):
            pytest.skip("not run: tmpfs mounts (needs root)")


def _works(script, folder):
    if os.geteuid() != 0 or shutil.which(ISOLATED[0]) is None:
        return False
    return subprocess.run([*ISOLATED, "sh", "-c", script], cwd=folder, capture_output=True, timeout=60).returncode == 0


@contextmanager
def fast_folder():
    """A new folder in memory where there is one, else where temporary files go."""
    memory = Path("/dev/shm")
    parent = memory if memory.is_dir() and os.access(memory, os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=parent, prefix="pmabench-") as folder:
        yield Path(folder)
