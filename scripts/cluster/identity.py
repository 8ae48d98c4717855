# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What two machines must have in common for their work to fit together to the bit: this code, Blender, numpy."""

from __future__ import annotations

import hashlib
import platform
from dataclasses import dataclass, fields
from functools import cache
from importlib import metadata
from pathlib import Path

import cv2
import numpy as np

SCRIPTS = Path(__file__).resolve().parents[1]
_SOURCES = (SCRIPTS.parent / "addon", SCRIPTS / "cluster")


@dataclass(frozen=True)
class Identity:
    """Versions of what the results depend on.

    Parameters
    ----------
    Scanstage : str
        A digest of the sources.
    Blender, Python, numpy, OpenCV : str
    """

    Scanstage: str
    Blender: str
    Python: str
    numpy: str
    OpenCV: str

    def difference(self, other: Identity) -> str | None:
        """Return in words how another machine differs from this one, or None."""
        for entry in fields(self):
            mine, theirs = getattr(self, entry.name), getattr(other, entry.name)
            if mine != theirs:
                return f"{entry.name} {theirs} instead of {mine}"
        return None

    @property
    def resource(self) -> str:
        """The name of the resource that only workers of this identity offer, so that only they are given its tasks."""
        return "scanstage-" + hashlib.sha256(repr(self).encode()).hexdigest()[:16]


@cache
def identity() -> Identity:
    """Return the identity of this process."""
    digest = hashlib.sha256()
    for file in sorted(path for folder in _SOURCES for path in folder.rglob("*.py")):
        digest.update(file.relative_to(SCRIPTS.parent).as_posix().encode() + b"\0" + file.read_bytes())
    return Identity(digest.hexdigest()[:12], _blender(), ".".join(platform.python_version_tuple()[:2]), np.__version__, cv2.__version__)


def _blender() -> str:
    try:
        return metadata.version("bpy")
    except metadata.PackageNotFoundError:  # a Blender, not its module
        import bpy

        return ".".join(map(str, bpy.app.version))
