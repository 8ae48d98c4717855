# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns as pictures that a real projector can show, in the order of their names, with their fields beside them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..files import making
from ..progress import Progress, silent
from ..reconstruction.active.patterns import Pattern
from .files import write_bytes
from .pictures import write_picture
from .schema import ENCODINGS

LIST = "patterns.json"


def write_patterns(folder: Path, patterns: Sequence[Pattern], *, encoding: str = "srgb", progress: Progress = silent) -> None:
    """Write one 8-bit PNG a pattern, ``pattern-0000.png`` and on, and ``patterns.json``.

    Parameters
    ----------
    folder : Path
        To make, or empty.
    patterns : sequence of Pattern
    encoding : {'srgb', 'linear'}
        How the projector turns values into light. Most follow sRGB, like screens; sinusoids need the right one.
    progress : Progress

    Raises
    ------
    ScanstageError
        The folder holds something already, or the disk refuses.
    """
    if encoding not in ENCODINGS:
        raise ValueError(f"encoding must be one of {ENCODINGS}, not {encoding!r}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ScanstageError(f"{folder}: is there already and not an empty folder; name another one for the patterns")
    digits = max(4, len(str(len(patterns) - 1)))
    entries = []
    with making(folder) as made:
        for index, pattern in enumerate(patterns):
            progress(index / len(patterns), f"Writing pattern {index + 1} of {len(patterns)}")
            name = f"pattern-{index:0{digits}d}.png"
            light = pattern.image / 255 if pattern.image.dtype == np.uint8 else pattern.image
            write_picture(made / name, light if light.ndim == 3 else np.repeat(light[..., None], 3, axis=2), encoding=encoding, bits=8)
            entries.append({"file": name, "id": pattern.id, "fields": dict(pattern.fields)})
        text = json.dumps({"size": list(patterns[0].image.shape[1::-1]), "encoding": encoding, "patterns": entries}, indent=1)
        write_bytes(made / LIST, text.encode() + b"\n")
    progress(1.0, f"{len(patterns)} patterns")
