# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How long work tells where it is, and how it is stopped.

Every long function takes ``progress``, a callable ``progress(fraction, message)`` with a fraction from 0 to 1. The
callable may raise `addon.errors.Cancelled`; the function then leaves nothing half-written and lets it through.
"""

from collections.abc import Callable

Progress = Callable[[float, str], None]


def silent(fraction: float, message: str) -> None:
    """Report to nobody: the default of every ``progress`` parameter."""


def part_of(progress: Progress, start: float, stop: float) -> Progress:
    """Return a progress callable for one part of the work, from ``start`` to ``stop`` of the whole."""

    def report(fraction: float, message: str) -> None:
        progress(start + (stop - start) * min(max(fraction, 0.0), 1.0), message)

    return report
