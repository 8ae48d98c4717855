# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures and volumes over several machines, by dask.distributed: the one place that imports it, and never in the extension.

- `identity`: what a worker and whoever gives it work must have in common.
- `connection`: a scheduler and its workers; giving out work and getting it back.
- `volumes`: hulls by bricks, shadows by views.
- `frames`: chunks of the plan.
- `workers`: these two as the command line takes them.
- `packing`: what goes over the network, and how it is laid together.
- `tasks`, `rendering`, `render_child`: what runs on the workers.
- `serving`: the verbs ``worker`` and ``scheduler``.

`scripts/scanstage.py` loads it as ``cluster``, beside ``addon``, on both sides.
"""

from .serving import VERBS, main
from .workers import connect

__all__ = ["VERBS", "connect", "main"]
