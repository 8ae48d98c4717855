# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What workers do with frames: each chunk in a Blender of its own, which ends with the worker and whose crash is not the worker's."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from addon.errors import ScanstageError

_CHILD = Path(__file__).with_name("render_child.py")
_running: set[subprocess.Popen] = set()


@dataclass(frozen=True)
class Blend:
    """A .blend file that workers can open.

    Parameters
    ----------
    path : str
        Where it lies, on machines that share its folder.
    digest : str
    data : bytes, optional
        All of it, for machines that do not.
    """

    path: str
    digest: str
    data: bytes | None

    def opened_at(self, folder: Path) -> Path:
        """Return where the file can be opened; ``folder`` is a temporary one."""
        if self.data is None:
            return Path(self.path)
        copy = folder / "staged.blend"
        copy.write_bytes(self.data)
        return copy


@dataclass(frozen=True)
class Order:
    """One frame to be rendered.

    Parameters
    ----------
    number : int
        Of the timeline.
    size : (int, int)
        Of its picture.
    """

    number: int
    size: tuple[int, int]


def digest_of(path: str) -> str | None:
    """Return a digest of a file, or None where it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def unreadable(paths: Sequence[str]) -> list[str]:
    """Return those of the paths that this machine cannot read."""
    return [path for path in paths if not os.access(path, os.R_OK)]


def render_chunk(blend: Blend, orders: Sequence[Order], note: str) -> list[bytes]:
    """Render frames and return their files.

    Raises
    ------
    ScanstageError
        Blender did not render them.
    """
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        task = {"file": str(blend.opened_at(Path(folder))), "folder": folder, "note": note,
                "frames": [[order.number, *order.size] for order in orders]}
        child = subprocess.Popen([sys.executable, str(_CHILD)], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                                 text=True)
        _running.add(child)
        try:
            child.stdin.write(json.dumps(task) + "\n")
            child.stdin.flush()  # and left open: the child ends when it closes, with this process
            problems = child.stderr.read()
            if child.wait():
                last = (problems.strip().splitlines() or ["it was stopped"])[-1]
                raise ScanstageError(f"frames {orders[0].number} to {orders[-1].number}: a worker's Blender did not render them "
                                     f"({last[:300]}); give the same command again")
        finally:
            _running.discard(child)
            child.stdin.close()
        return [(Path(folder) / f"{order.number:04d}.png").read_bytes() for order in orders]


def stop_rendering() -> None:
    """End what this worker renders, at once."""
    for child in list(_running):
        child.kill()
