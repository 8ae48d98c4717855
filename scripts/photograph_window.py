# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs the extension in the window of a real Blender: step by step, or what a walk of its own shows.

    SCANSTAGE_BLENDER=/path/to/blender python3 scripts/photograph_window.py EXTENSION.zip OUT [WALK.py]

`scripts/window_pictures.py` is the walk that takes the README's pictures.

``SCANSTAGE_BLENDER`` is a Blender, or a command with arguments that starts one. Where there is no display, one that nobody
sees is made with ``xvfb-run``. Preferences and extensions are kept in OUT: the user's own stay as they are.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

WALK = Path(__file__).resolve().with_name("window_walk.py")
SIZE = ("1280", "960")
_MOST = 600  # seconds that a walk may take


def blender_command() -> list[str] | None:
    """Return the command that starts the Blender of ``SCANSTAGE_BLENDER``, or None where that is not set."""
    command = shlex.split(os.environ.get("SCANSTAGE_BLENDER", ""))
    return command or None


def photograph(command: list[str], extension: Path, out: Path, walk: Path = WALK) -> tuple[dict, str]:
    """Install an extension into a Blender without any other and walk through it; events are those that ``walk`` simulates.

    Returns
    -------
    found : dict
        What the walk found; empty if Blender ended before it did.
    log : str
        All that Blender wrote, errors of panels among it.
    """
    out = out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    user = out / "user"
    user.mkdir(parents=True)
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(user)}
    has_display = os.environ.get("DISPLAY") or "xvfb-run" in command
    window = command if has_display else ["xvfb-run", "-a", "-s", f"-screen 0 {'x'.join(SIZE)}x24 +extension GLX", *command]
    log = ""
    for call in ([*command, "--background", "--command", "extension", "install-file", "-r", "user_default", "-e", str(extension.resolve())],
                 [*window, "--enable-event-simulate", "--window-geometry", "0", "0", *SIZE, "--python", str(walk), "--", str(out)]):
        done = subprocess.run(call, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=_MOST,
                              check=False)
        log += done.stdout
    report = out / "walk.json"
    return json.loads(report.read_text(encoding="utf-8")) if report.is_file() else {}, log


def main() -> int:
    """Photograph, and return 1 with Blender's log if anything went wrong."""
    command = blender_command()
    if command is None or len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    found, log = photograph(command, *map(Path, sys.argv[1:]))
    if "error" in found or "Traceback" in log:
        sys.stderr.write(log)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
