# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a verb again and again and kills it before one step on the disk after the other; a program of its own, for it forks.

    python -m tests.killing FOLDER MOST VERB ...

FOLDER/before holds what is there before. The verb runs in copies of it: in FOLDER/whole to its end; in FOLDER/killed-N until
its N-th opening for writing, renaming, making or removing of something, where it is gone as by SIGKILL; and in FOLDER/again-N,
a copy of what the killed one left, to its end. At most MOST of the steps are tried, spread over all; FOLDER/steps lists them.
"""

import os
import shutil
import signal
import sys
import warnings
from pathlib import Path

STEPS = ("os.rename", "os.mkdir", "os.rmdir", "os.remove", "shutil.copyfile")
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def touches(event, args, folder):
    """Return whether an audit event is a step on the disk that changes something in a folder."""
    if event == "open":
        path, _, flags = args
        return isinstance(path, str) and bool(flags & WRITES) and inside(path, folder)
    return event in STEPS and inside(args[1] if event == "shutil.copyfile" else args[0], folder)


def inside(path, folder):
    return str(Path(os.fsdecode(path)).absolute()).startswith(str(folder))  # a removal by descriptor gives the name alone: in here as well


def watch(folder, last):
    """Note this process's steps in a pipe's end, and end it before the ``last`` one."""
    count = 0

    def hook(event, args):
        nonlocal count
        if touches(event, args, folder):
            count += 1
            if count == last:
                os.kill(os.getpid(), signal.SIGKILL)
            os.write(watch.pipe, f"{event}\n".encode())

    sys.addaudithook(hook)


def run(folder, verb, last=0):
    """Run a verb in a folder, in a child; return the steps that it did, and whether it came to its end."""
    from addon.cli.main import main

    read, watch.pipe = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # that this process has threads: Blender's are idle
        child = os.fork()
    if child == 0:
        os.chdir(folder)
        watch(folder, last)
        os._exit(main(verb))
    os.close(watch.pipe)
    with os.fdopen(read) as steps:
        done = steps.read().split()
    ended = os.waitpid(child, 0)[1]
    if ended not in (0, signal.SIGKILL):
        raise SystemExit(f"the verb failed: {ended}")
    return done, ended == 0


def main():
    import bpy  # noqa: F401  # once, for all children

    folder, most, verb = Path(sys.argv[1]).resolve(), int(sys.argv[2]), sys.argv[3:]
    shutil.copytree(folder / "before", folder / "whole")
    steps, _ = run(folder / "whole", verb)
    chosen = range(1, len(steps) + 1) if len(steps) <= most else sorted({round(1 + n * (len(steps) - 1) / (most - 1)) for n in range(most)})
    for last in chosen:
        killed, again = folder / f"killed-{last}", folder / f"again-{last}"
        shutil.copytree(folder / "before", killed)
        if run(killed, verb, last)[1]:
            raise SystemExit(f"step {last} was never reached")
        shutil.copytree(killed, again)
        run(again, verb)
        with open(folder / "steps", "a") as file:
            print(last, steps[last - 1], file=file)


if __name__ == "__main__":
    main()
    os._exit(0)  # the bpy wheel of Blender 4.5 sometimes hangs when the interpreter takes its modules down
