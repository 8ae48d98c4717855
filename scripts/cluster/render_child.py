# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders one chunk of a plan for a worker, which starts this script: a line of JSON on stdin, files into a folder.

It ends when stdin closes, so that nothing goes on rendering for a worker that has died.
"""

import importlib.util
import json
import os
import sys
import threading
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def main():
    task = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_stdin, daemon=True).start()
    spec = importlib.util.spec_from_file_location("addon", ROOT / "addon" / "__init__.py", submodule_search_locations=[str(ROOT / "addon")])
    sys.modules["addon"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules["addon"])
    import bpy

    from addon.errors import ScanstageError
    from addon.render.capture import Shot, render_frames
    from addon.results.blend import open_blend

    try:
        open_blend(Path(task["file"]))
        frames = [Shot(str(number), number, Path(task["folder"]) / f"{number:04d}.png", (width, height))
                  for number, width, height in task["frames"]]
        for _ in render_frames(bpy.context.scene, frames, task["note"]):
            pass
    except ScanstageError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _end_with_stdin():
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    os._exit(code)  # Blender's own shutdown may hang
