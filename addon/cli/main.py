# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the arguments, runs the verb, and turns what happens into an exit status.

0 done, 1 the input is bad (one line, ``scanstage: error: ...``), 2 the call is wrong, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..errors import Cancelled, ScanstageError
from ..files import replacing
from .progress_bar import ProgressBar, muted_stdout
from .verbs import VERBS

DONE, BAD_INPUT, INTERRUPTED = 0, 1, 130
# argparse takes "-1e-3" for an option, for want of an exponent in its idea of a number; not so with a space before it.
_NEGATIVE = re.compile(r"^-(\d+\.?\d*|\.\d+)e[+-]?\d+$", re.IGNORECASE)


def main(arguments: Sequence[str] | None = None, cluster: object | None = None) -> int:
    """Run one verb.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the program's name; ``sys.argv``'s if left out.
    cluster : module, optional
        What connects to other machines, for ``--scheduler``: a clone has it, the extension does not.

    Returns
    -------
    int
        The exit status.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        call = build_parser().parse_args([_NEGATIVE.sub(r" \g<0>", argument) for argument in arguments])
    except SystemExit as end:  # argparse has said why; Blender's own --command wants a number, not an exit
        return int(end.code or 0)
    call.cluster = cluster
    bar = ProgressBar(quiet=call.quiet)
    try:
        if call.report:
            check_report(call.report)
        with muted_stdout():  # from the first import of Blender on
            report = call.run(call, bar)
        lines = report.pop("lines", ())
        if call.report:
            write_report(call.report, report)
        bar.close()
        _print(lines)
    except ScanstageError as error:
        return _failed(bar, str(error))
    except OSError as error:  # what no step foresaw: a disk that is full, a folder that was taken away
        return _failed(bar, f"{error.filename or 'the system'}: {error.strerror or error}; check the disk space and the rights")
    except MemoryError:
        return _failed(bar, "there is not enough memory; use fewer voxels or smaller pictures")
    except (KeyboardInterrupt, Cancelled):
        bar.close()
        print("scanstage: interrupted; what is whole on disk stays, and the same command goes on from there", file=sys.stderr)
        return INTERRUPTED
    return DONE


def _failed(bar: ProgressBar, sentence: str) -> int:
    bar.close()
    print(f"scanstage: error: {' '.join(sentence.splitlines())}", file=sys.stderr)
    return BAD_INPUT


def _print(lines: Iterable[str]) -> None:
    try:
        for line in lines:
            print(line)
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads has seen enough, as `| head` does; the flush at the end must not fail again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Parser(argparse.ArgumentParser):
    """A parser whose help may end with what is found out only when it is asked for."""

    def format_help(self) -> str:
        if callable(self.epilog):
            with muted_stdout():  # it may import Blender
                self.epilog = self.epilog()
        return super().format_help()


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all verbs."""
    parser = _Parser(prog="scanstage", description="Design, simulate and evaluate 3-D scanning rigs.")
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    for name, verb in VERBS.items():
        entry = verbs.add_parser(name, help=verb.help, description=verb.help + ".", epilog=verb.epilog,
                                 formatter_class=argparse.RawDescriptionHelpFormatter)
        verb.arguments(entry)
        entry.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], type=_assignment, dest="settings",
                           help="an option of the preset, method or format; repeat for more (see `methods` and `presets`)")
        entry.add_argument("--report", metavar="FILE.json", type=Path, help="write what the verb found as JSON, too")
        entry.add_argument("--quiet", action="store_true", help="no progress on stderr")
        entry.set_defaults(run=verb.run)
    return parser


def check_report(path: Path) -> None:
    """Refuse a place where no report can be written, before the work is done."""
    if path.is_dir() or not path.parent.is_dir():
        raise ScanstageError(f"{path}: cannot be written; name a file, in a folder that is there, with --report")


def write_report(path: Path, report: dict) -> None:
    """Write a report, whole or not at all."""
    with replacing(path) as file:
        file.write(json.dumps(report, indent=1).encode() + b"\n")


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name.strip(), value
