# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs verbs on a disk that is full or read-only: a real one, mounted for this process alone; a program of its own, and root's.

    unshare --mount python -m tests.small_disk FOLDER CASES.json

FOLDER/before holds what the disk holds before. A case is [name, kilobytes that are free, or null for read-only, arguments]. For each
prints a line of JSON: the exit status, what the verb said, and what changed on the disk.
"""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

SIZE = 1 << 20


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b"" for path in sorted(folder.rglob("*"))}


def mounted(disk, before, free):
    """Mount a small disk with what is there before, and leave so many kilobytes of it free; None makes it read-only."""
    disk.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", disk], check=True)
    subprocess.run(["cp", "-r", f"{before}/.", disk], check=True)
    if free is None:
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        return
    there = os.statvfs(disk)
    (disk / "filler").write_bytes(bytes(max(0, there.f_bavail * there.f_frsize - (free << 10))))


def run(disk, arguments, said):
    """Run a verb in a child, and return its exit status."""
    from addon.cli.main import main

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # that this process has threads: Blender's are idle
        child = os.fork()
    if child == 0:
        os.chdir(disk)
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        os._exit(main([*arguments, "--quiet"]))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main():
    import bpy  # noqa: F401  # once, for all children

    folder, cases = Path(sys.argv[1]).resolve(), json.loads(Path(sys.argv[2]).read_text())
    disk, said = folder / "disk", folder / "said"
    for name, free, arguments in cases:
        mounted(disk, folder / "before", free)
        before = contents(disk)
        status = run(disk, arguments, said)
        after = contents(disk)
        changed = sorted(path for path in before.keys() | after.keys() if before.get(path) != after.get(path))
        subprocess.run(["umount", disk], check=True)
        with open(folder / "found", "a") as file:
            print(json.dumps([name, status, said.read_text(errors="replace"), changed]), file=file)


if __name__ == "__main__":
    main()
    os._exit(0)  # the bpy wheel of Blender 4.5 sometimes hangs when the interpreter takes its modules down
