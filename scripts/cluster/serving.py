# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The verbs ``scheduler`` and ``worker``: they run until they are stopped."""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
from collections.abc import Sequence

from dask.utils import parse_bytes
from distributed import Scheduler, Worker
from distributed.comm.addressing import get_address_host, normalize_address
from distributed.utils import get_ip

from .identity import identity

VERBS = {"scheduler": "give out the work of `capture` and `reconstruct --scheduler ADDRESS` to workers",
         "worker": "do work for a scheduler"}
_PORT = 8786
_ANSWER = 10  # seconds in which a scheduler answers


def main(arguments: Sequence[str]) -> int:
    """Run one of the two verbs; return the exit status."""
    call = _parser().parse_args(arguments)
    logging.getLogger("distributed").setLevel(logging.WARNING)
    try:
        asyncio.run(call.serve(call))
    except KeyboardInterrupt:
        return 130
    except (OSError, ValueError, TypeError, RuntimeError) as error:  # the last wraps what it is really about
        reason = str(error.__cause__ or error).splitlines() or ["no answer"]
        print(f"scanstage: error: {call.address}: cannot be used ({reason[0][:200]}); {call.remedy}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="scanstage", description="Both ends of --scheduler. Only for a network whose machines trust each "
                                     "other: whoever reaches a scheduler can run any program on its workers.")
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    scheduler = verbs.add_parser("scheduler", help=VERBS["scheduler"], description=VERBS["scheduler"] + ".")
    scheduler.add_argument("address", nargs="?", default=f"tcp://127.0.0.1:{_PORT}", metavar="ADDRESS",
                           help="where to listen (default: %(default)s, this machine only; tcp://0.0.0.0 is every network it has)")
    scheduler.set_defaults(serve=_scheduler, remedy="give an address of this machine and a free port, such as tcp://10.0.0.1:8786")
    worker = verbs.add_parser("worker", help=VERBS["worker"], description=VERBS["worker"] + ".")
    worker.add_argument("address", metavar="ADDRESS", help="the scheduler's, such as tcp://10.0.0.1:8786")
    worker.add_argument("--host", help="this machine's address as the others see it (default: that of the way to the scheduler)")
    worker.add_argument("--memory", metavar="SIZE", type=parse_bytes,
                        help="the most it may take, such as 2GiB; work that needs more fails in it, and it goes on (default: no limit)")
    worker.set_defaults(serve=_worker, remedy="start one there with `python3 scripts/scanstage.py scheduler`, or correct the address")
    return parser


async def _scheduler(call: argparse.Namespace) -> None:
    _, _, port = call.address.rpartition("//")[2].partition(":")
    async with Scheduler(host=call.address if port else f"{call.address}:{_PORT}", dashboard=False,
                         dashboard_address="127.0.0.1:0") as scheduler:
        print(f"scheduler at {scheduler.address}", flush=True)
        await scheduler.finished()


async def _worker(call: argparse.Namespace) -> None:
    if call.memory:
        _limit_memory(call.memory)
    address = normalize_address(call.address)
    host = call.host or get_ip(get_address_host(address))
    async with asyncio.timeout(_ANSWER):
        worker = await Worker(address, host=host, nthreads=1, memory_limit=0, dashboard=False, resources={identity().resource: 1})
    print(f"worker at {worker.address} for {call.address}", flush=True)
    try:
        await worker.finished()
    finally:
        await worker.close()


def _limit_memory(size: int) -> None:
    try:
        import resource
    except ImportError:
        raise ValueError("--memory needs a POSIX system") from None
    resource.setrlimit(resource.RLIMIT_DATA, (size, size))
