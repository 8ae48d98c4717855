# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress on stderr: a bar on a terminal, one line per step elsewhere, nothing when told to be quiet."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, redirect_stdout

from ..progress import Progress

_WIDTH = 30
_SECONDS_BETWEEN_DRAWS = 0.1


class ProgressBar:
    """A progress callback that draws itself.

    Parameters
    ----------
    quiet : bool
        Draw nothing.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._stream = None if quiet else sys.stderr
        self._terminal = bool(self._stream) and self._stream.isatty()
        self._message, self._drawn = "", 0.0

    def __call__(self, fraction: float, message: str) -> None:
        if self._stream is None:
            return
        if not self._terminal:
            if message.split(" ", 1)[0] != self._message:  # one line a kind of step, not one a picture
                self._message = message.split(" ", 1)[0]
                print(message, file=self._stream, flush=True)
            return
        now = time.monotonic()
        if now - self._drawn < _SECONDS_BETWEEN_DRAWS and message == self._message and fraction < 1:
            return
        self._message, self._drawn = message, now
        filled = round(_WIDTH * min(max(fraction, 0.0), 1.0))
        print(f"\r{'█' * filled}{'░' * (_WIDTH - filled)} {100 * fraction:3.0f} % {message:<40.40}", end="", file=self._stream, flush=True)

    def close(self) -> None:
        """Clear the bar, so that results stand alone."""
        if self._terminal and self._message:
            print("\r" + " " * (_WIDTH + 50) + "\r", end="", file=self._stream, flush=True)
        self._message = ""


def drain(steps: Generator[tuple[float, str], None, None], progress: Progress) -> None:
    """Run a generator of steps to its end, reporting each; it is closed, and so cleans up, where the reporting stops it."""
    with closing(steps):
        for fraction, message in steps:
            progress(fraction, message)


@contextmanager
def muted_stdout() -> Iterator[None]:
    """Keep what Blender prints (a line per rendered frame) out of stdout, which is for results.

    Its Python writes to `sys.stdout`, its C code to the file descriptor.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        with open(os.devnull, "w") as sink, redirect_stdout(sink):
            os.dup2(sink.fileno(), 1)
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
