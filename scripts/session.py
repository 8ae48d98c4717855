# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scripts that work with Blender share: their environment, its beginning and its end."""

import importlib.util
import os
import shutil
import sys
from pathlib import Path

import environment
import scanstage

ROOT = Path(__file__).resolve().parents[1]


def run(script, work, needs=("bpy",), extras=()):
    """Run ``work(bar)`` in the script's environment, with the clone's `addon` imported; return the exit status.

    Parameters
    ----------
    script : path
        The calling script, which is run again if the environment is not the running one.
    work : callable
        Takes a progress bar and returns the exit status; a `ScanstageError` becomes one line on stderr and 1.
    needs : sequence of str
        Modules that show whether the environment is the running one.
    extras : sequence of str
        As `environment.prepare` takes them.
    """
    name = Path(script).stem
    if any(importlib.util.find_spec(module) is None for module in needs):
        try:
            return environment.run_again(script, extras)
        except environment.SetupError as error:
            print(f"{name}: error: {error}", file=sys.stderr)
            return 1
    scanstage.load("addon", ROOT / "addon" / "__init__.py")
    import bpy  # before OpenCV: both bring libraries of their own

    from addon.cli.progress_bar import ProgressBar
    from addon.errors import ScanstageError

    print(f"Blender {bpy.app.version_string}", file=sys.stderr)
    bar = ProgressBar()
    try:
        return work(bar)
    except ScanstageError as error:
        bar.close()
        print(f"{name}: error: {error}", file=sys.stderr)
        return 1
    finally:
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # Blender's own, which `end` would leave behind


def told(bar, name):
    """Return a progress callable that says whose progress it is."""
    return lambda fraction, message: bar(fraction, f"{name}: {message}")


def end(code):
    """End the process: Blender's own shutdown may print to stdout."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
