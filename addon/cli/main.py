# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the arguments, runs the verb, and turns what happens into an exit status.

0 done, 1 the input is bad (one line, ``scanstage: error: ...``), 2 the call is wrong, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ..errors import Cancelled, ScanstageError
from ..results.files import replacing
from .progress_bar import ProgressBar
from .verbs import VERBS

DONE, BAD_INPUT, INTERRUPTED = 0, 1, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the program's name; ``sys.argv``'s if left out.

    Returns
    -------
    int
        The exit status.
    """
    try:
        call = build_parser().parse_args(arguments)
    except SystemExit as end:  # argparse has said why; Blender's own --command wants a number, not an exit
        return int(end.code or 0)
    bar = ProgressBar(quiet=call.quiet)
    try:
        report = call.run(call, bar)
        bar.close()
        for line in report.pop("lines", ()):
            print(line)
        if call.report:
            write_report(Path(call.report), report)
    except ScanstageError as error:
        bar.close()
        print(f"scanstage: error: {error}", file=sys.stderr)
        return BAD_INPUT
    except (KeyboardInterrupt, Cancelled):
        bar.close()
        print("scanstage: interrupted; what is whole on disk stays, and the same command goes on from there", file=sys.stderr)
        return INTERRUPTED
    return DONE


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all verbs."""
    parser = argparse.ArgumentParser(prog="scanstage", description="Design, simulate and evaluate 3-D scanning rigs.")
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    for name, verb in VERBS.items():
        entry = verbs.add_parser(name, help=verb.help, description=verb.help + ".", epilog=verb.epilog,
                                 formatter_class=argparse.RawDescriptionHelpFormatter)
        verb.arguments(entry)
        entry.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], type=_assignment, dest="settings",
                           help="an option of the preset, method or format; repeat for more (see `methods` and `presets`)")
        entry.add_argument("--report", metavar="FILE.json", help="write what the verb found as JSON, too")
        entry.add_argument("--quiet", action="store_true", help="no progress on stderr")
        entry.set_defaults(run=verb.run)
    return parser


def write_report(path: Path, report: dict) -> None:
    """Write a report, whole or not at all."""
    with replacing(path) as file:
        file.write(json.dumps(report, indent=1).encode() + b"\n")


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name.strip(), value
