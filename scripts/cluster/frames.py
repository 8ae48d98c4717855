# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames over workers: chunks of the plan, each rendered from the same .blend, and sent back as files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

from addon.captures.files import write_bytes
from addon.captures.picture_format import read_header
from addon.errors import ScanstageError
from addon.render.capture import Shot

from .connection import Connection
from .rendering import Blend, Order, digest_of, render_chunk, stop_rendering, unreadable

_CHUNKS_A_WORKER = 4  # so that none waits long for the last
_LONGEST_CHUNK = 32


class Frames:
    """Renders on workers.

    Parameters
    ----------
    connection : Connection
    file : Path
        The open .blend.
    refers_to : sequence of str
        The files beside it that it needs, with absolute paths.

    Raises
    ------
    ScanstageError
        Workers see neither the .blend nor one of these files.
    """

    def __init__(self, connection: Connection, file: Path, refers_to: Sequence[str]) -> None:
        self._connection, path = connection, str(Path(file).resolve())
        self._digest = digest_of(path)
        seen = all(digest == self._digest for digest in connection.everywhere(digest_of, path).values())
        for worker, unseen in connection.everywhere(unreadable, list(refers_to)).items():
            if refers_to and (unseen or not seen):
                raise ScanstageError(f"{file}: needs {(unseen or refers_to)[0]}, and worker {worker} cannot see both where they are; pack "
                                     "what it needs (File > External Data > Pack Resources), or use a folder that the workers share")
        self._blend, = connection.send([Blend(path, self._digest, None if seen else Path(path).read_bytes())])

    def __call__(self, shots: Sequence[Shot], note: str) -> Iterator[str | None]:
        """Render shots, in chunks; yield the id of each whose picture is on disk, and None while there is nothing new."""
        length = min(_LONGEST_CHUNK, max(1, -(-len(shots) // (_CHUNKS_A_WORKER * max(1, self._connection.count())))))
        chunks = [shots[start:start + length] for start in range(0, len(shots), length)]
        tasks = [(self._blend, [Order(shot.number, shot.size) for shot in chunk], note) for chunk in chunks]
        finished = False
        try:
            with closing(self._connection.results(render_chunk, tasks)) as answers:
                for answer in answers:
                    if answer is None:
                        yield None
                        continue
                    for shot, data in zip(chunks[answer[0]], answer[1], strict=True):
                        _write(shot, data)
                        yield shot.id
            finished = True
        finally:
            if not finished:
                self._connection.everywhere(stop_rendering)


def _write(shot: Shot, data: bytes) -> None:
    header = read_header(data)
    if header is None or not header.fits(shot.size):
        raise ScanstageError(f"{shot.path}: a worker sent a picture that is not whole; give the same command again")
    write_bytes(shot.path, data)
