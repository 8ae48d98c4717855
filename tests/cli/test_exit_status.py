# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The exit status through the real doors: what fails is never 0, not even where the program itself is broken."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.photograph_window import blender_command

ROOT = Path(__file__).resolve().parents[2]


def door(name: str, root: Path) -> list[str]:
    """Return how a verb is called: by Python, or by ``blender --background``."""
    script = str(root / "scripts" / "scanstage.py")
    if name == "python":
        return [sys.executable, script]
    command = blender_command()
    if command is None:
        pytest.skip("set SCANSTAGE_BLENDER to a real Blender")
    return [*command, "--background", "--factory-startup", "--python", script, "--"]


def status(command, folder) -> tuple[int, str]:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    return done.returncode, done.stderr


@pytest.mark.parametrize("name", ["python", "blender"])
@pytest.mark.parametrize(("verb", "expected"), [
    ("methods", 0), ("stage carousel --out new.blend", 1), ("evaluate nothing", 1), ("reconstruct nothing visual-hull --out new", 1),
    ("carve everything", 2), ("stage turntable", 2)])
def test_the_status_says_what_went_wrong(tmp_path, name, verb, expected):
    found, said = status([*door(name, ROOT), *verb.split(), *(["--quiet"] if expected < 2 else [])], tmp_path)
    assert found == expected, said


@pytest.mark.parametrize("name", ["python", "blender"])
@pytest.mark.parametrize("fault", ["raise RuntimeError('broken')", "this is no Python", "import no_such_module"])
def test_a_program_that_is_broken_does_not_end_with_0(tmp_path, name, fault):
    copy = tmp_path / "clone"
    for folder in ("addon", "scripts"):
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    with open(copy / "addon" / "cli" / "verbs.py", "a") as file:
        file.write(f"\n{fault}\n")
    found, said = status([*door(name, copy), "methods"], tmp_path)
    assert found == 1 and "Error" in said, said
