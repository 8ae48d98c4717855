# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures that several folders share. bpy is imported only by the tests that ask for a scene."""

import pytest


@pytest.fixture
def empty_scene():
    """Return the scene of a new, empty file with factory settings."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene
