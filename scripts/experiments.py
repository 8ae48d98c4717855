# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reproduces the lecture's slides on volumetric stereo, each as a table and a picture.

    python3 scripts/experiments.py                         the list of experiments
    python3 scripts/experiments.py hull-2d                 one: its table to stdout, its picture to build/experiments/hull-2d.png
    python3 scripts/experiments.py all --out FOLDER        all of them (minutes: three objects are rendered in 72 poses)

What is rendered stays in FOLDER/captures and is not rendered again. It makes its own environment on first use.
"""

import argparse
import sys
from pathlib import Path

import session

OUT = Path("build") / "experiments"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="?", help="an experiment, or all; without it they are listed")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder for the pictures and captures (default: {OUT})")
    call = parser.parse_args()
    return session.run(__file__, lambda bar: perform(call.name, call.out, bar), needs=("bpy", "matplotlib"), extras=("experiments",))


def perform(name, out, bar):
    """Run one experiment or all, or list them; return the exit status."""
    from experiments import EXPERIMENTS

    if name is None:
        print("\n".join(f"{experiment.name:<20} {experiment.description}" for experiment in EXPERIMENTS.values()))
        return 0
    if name != "all" and name not in EXPERIMENTS:
        print(f"experiments: error: there is no experiment {name!r}; they are: {', '.join(EXPERIMENTS)}, all", file=sys.stderr)
        return 2
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"experiments: error: --out: {out} cannot be made a folder ({error.strerror}); choose another", file=sys.stderr)
        return 1
    for experiment in EXPERIMENTS.values() if name == "all" else [EXPERIMENTS[name]]:
        table = experiment.run(out, session.told(bar, experiment.name))
        bar.close()
        print("", f"## {experiment.name}", experiment.description, table.markdown(), f"Picture: {out / experiment.name}.png",
              sep="\n\n", flush=True)
    return 0


if __name__ == "__main__":
    session.end(main())
