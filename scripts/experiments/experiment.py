# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What an experiment is."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Experiment:
    """One experiment.

    Parameters
    ----------
    name : str
        As a user calls it, and the name of its picture.
    description : str
        One sentence.
    run : callable
        ``run(out, progress)`` writes ``out/<name>.png`` and returns a `tables.Table`. What it renders goes to
        ``out/captures``, where the next run finds it.
    """

    name: str
    description: str
    run: Callable
