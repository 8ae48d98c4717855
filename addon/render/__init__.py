# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the plan on the timeline into a capture set.

- `settings`: the capture settings, for as long as a block lasts.
- `capture`: plays the plan: pictures, clean plates, the true object and `capture.json`.
"""

from .capture import capture_frames

__all__ = ["capture_frames"]
