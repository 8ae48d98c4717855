# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the linter and the whole test suite on every supported Blender whose Python is on this machine.

    python3 scripts/test.py                    both Blenders
    python3 scripts/test.py -k hull            what follows goes to pytest
    python3 scripts/test.py --coverage         also tell which lines of addon/reconstruction and addon/captures no test runs, on the
                                               newest Blender alone; status 1 if those that are run are fewer than 95 %

Standard library only: it makes the environments that it needs.
"""

import subprocess
import sys
from pathlib import Path

import environment

ROOT = Path(__file__).resolve().parents[1]


def main():
    failed, pythons, arguments = False, environment.interpreters(), sys.argv[1:]
    measured = "--coverage" in arguments
    if measured:
        arguments.remove("--coverage")
        pythons = dict(sorted(pythons.items())[-1:])
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
        runner = [interpreter, "-m", *(["coverage", "run", "-m"] if measured else []), "pytest", *arguments]
        failed |= subprocess.call([str(part) for part in runner], cwd=ROOT) != 0
        if measured:
            failed |= subprocess.call([interpreter, "-m", "coverage", "report"], cwd=ROOT) != 0
    for version in () if measured else environment.BLENDERS.keys() - pythons.keys():
        print("NOT RUN: Blender %s, because Python %d.%d is not on this machine" % (environment.BLENDERS[version], *version))
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
