# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the linter and the whole test suite on every supported Blender whose Python is on this machine.

    python3 scripts/test.py                    both Blenders
    python3 scripts/test.py -k hull            what follows goes to pytest

Standard library only: it makes the environments that it needs.
"""

import subprocess
import sys
from pathlib import Path

import environment

ROOT = Path(__file__).resolve().parents[1]


def main():
    failed, pythons = False, environment.interpreters()
    if not pythons:
        pythons[sys.version_info[:2]] = sys.executable  # to be told which are needed
    for version, python in pythons.items():
        try:
            interpreter = environment.prepare(python, extras=("development", "experiments"))
            environment.install_cluster(interpreter)
        except environment.SetupError as error:
            print("scanstage: error: %s" % error, file=sys.stderr)
            return 1
        print("\n== Blender %s, Python %d.%d" % (environment.BLENDERS[version], *version), flush=True)
        failed |= subprocess.call([interpreter, "-m", "ruff", "check", "."], cwd=ROOT) != 0
        failed |= subprocess.call([interpreter, "-m", "pytest", *sys.argv[1:]], cwd=ROOT) != 0
    for version in environment.BLENDERS.keys() - pythons.keys():
        print("NOT RUN: Blender %s, because Python %d.%d is not on this machine" % (environment.BLENDERS[version], *version))
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
