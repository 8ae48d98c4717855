# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests in a real window share."""

from pathlib import Path

import pytest

from scripts.build_extension import ROOT
from scripts.photograph_window import blender_command, photograph


@pytest.fixture(scope="module")
def walk_through(tmp_path_factory):
    """A function that has a Blender with the extension take a walk; returns what it found, Blender's log, and the folder it left."""
    command = blender_command()
    if command is None:
        pytest.skip("set SCANSTAGE_BLENDER to a Blender with a window")
    archives = sorted((ROOT / "dist").glob("scanstage-*-linux_x64.zip"))
    if not archives:
        pytest.skip("build the extension first: scripts/build_extension.py")

    def take(walk: Path) -> tuple[dict, str, Path]:
        out = tmp_path_factory.mktemp("window")
        return *photograph(command, archives[-1], out, walk), out
    return take
