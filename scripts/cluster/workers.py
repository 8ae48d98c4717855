# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""All that workers can do, for the verbs `capture` and `reconstruct`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .connection import connected
from .tasks import forget
from .volumes import Volumes


class Workers(Volumes):
    """Carves and renders on workers."""

    def renderer(self, file: Path):
        """Return what renders shots of a .blend, the one that is open here, as `addon.render.capture.capture_frames` takes it."""
        import bpy

        from .frames import Frames

        return Frames(self._connection, file, sorted(bpy.utils.blend_paths(absolute=True, packed=False)))


@contextmanager
def connect(address: str) -> Iterator[Workers]:
    """Connect to a scheduler for as long as a block lasts. See `connection.connected`."""
    with connected(address) as connection:
        try:
            yield Workers(connection)
        finally:
            with suppress(OSError):  # no worker is left, or no scheduler
                connection.everywhere(forget)
