# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures that several folders share. bpy is imported only by the tests that ask for a scene."""

import os
import sys
from pathlib import Path

import pytest


@pytest.fixture
def empty_scene():
    """Return the scene of a new, empty file with factory settings."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def real_captures():
    """Return a function that gives the folder of a set of real photographs, or skips the test."""
    root = Path(os.environ.get("SCANSTAGE_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))

    def folder(name: str) -> Path:
        if not (root / name).is_dir():
            pytest.skip(f"the real captures {name} are not in {root}; set SCANSTAGE_DATA")
        return root / name

    return folder


_status = 0


def pytest_sessionfinish(session, exitstatus):
    """Remember how the tests ended."""
    global _status
    _status = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """End here: the bpy wheel of Blender 4.5 sometimes hangs when the interpreter takes its modules down."""
    if "bpy" in sys.modules:
        if "coverage" in sys.modules and (measured := sys.modules["coverage"].Coverage.current()) is not None:
            measured.stop()
            measured.save()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(_status)
