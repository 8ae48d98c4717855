# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The same pictures give the same bytes: with one thread and with four, and on every Blender that is here."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from addon.reconstruction.methods import METHODS

ROOT = Path(__file__).resolve().parents[1]
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
OTHERS = [python for python in sorted((ROOT / ".venv").glob("blender-*/bin/python"))
          if python.parent.resolve() != Path(sys.executable).parent.resolve()]


def digests(python, folder, threads: int) -> dict[str, tuple]:
    """Return by the method what it was given and what it wrote, as `tests.digests` prints them."""
    done = subprocess.run([python, "-m", "tests.digests", folder, str(threads)], cwd=ROOT, capture_output=True, text=True, timeout=400,
                          env={**os.environ, **dict.fromkeys(THREADS, str(threads))})
    assert done.returncode == 0, done.stderr
    return {name: rest for name, *rest in map(json.loads, done.stdout.splitlines())}


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    return digests(sys.executable, tmp_path_factory.mktemp("here"), threads=1)


def test_the_number_of_threads_changes_no_byte(tmp_path, here):
    assert here.keys() == {name for name, entry in METHODS.items() if not entry.cuts_solids}  # Blender's solver cuts the others
    assert all({"volume.npz", "mesh.ply", "result.json"} <= files.keys() for _, files in here.values())
    assert digests(sys.executable, tmp_path, threads=4) == here


@pytest.mark.skipif(not OTHERS, reason="the environment of no other Blender is here; scripts/test.py makes it")
def test_another_blender_writes_the_same_bytes(tmp_path, here):
    for python in OTHERS:
        there = digests(python, tmp_path / python.parents[1].name, threads=2)
        assert {name: given for name, (given, _) in there.items()} == {name: given for name, (given, _) in here.items()}  # or it proves nothing
        assert there == here
