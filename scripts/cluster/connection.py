# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A scheduler and its workers, as those who have work see them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress

from distributed import CancelledError, Client, Future, wait
from distributed.comm.core import CommClosedError
from distributed.scheduler import KilledWorker

from addon.errors import ScanstageError

from .identity import identity

LOOK = 0.2  # seconds between looks whether the user wants to stop
_ANSWER = 5  # seconds in which a scheduler answers
_FIRST_WORKER = 15  # seconds in which one worker is there
_NO_WORKER = 30  # seconds without any before the work is given up
_ENDS = ("finished", "error", "cancelled")
START = "python3 scripts/scanstage.py worker {}"


class Connection:
    """Gives tasks to workers that are what this process is, and gets them back.

    Parameters
    ----------
    client : Client
    address : str
        The scheduler's, for error messages.
    """

    def __init__(self, client: Client, address: str) -> None:
        self._client, self._address = client, address

    def count(self) -> int:
        """Return how many workers there are."""
        return len(self._client.nthreads())

    def send(self, values: list) -> list[Future]:
        """Put what many tasks take on every worker, once; the tasks are given what this returns."""
        return self._client.scatter(values, broadcast=True, hash=False)

    def everywhere(self, function: Callable, *args) -> dict[str, object]:
        """Call a function on every worker at once, whatever they are busy with; return what it returns by worker."""
        return self._client.run(function, *args)

    def results(self, function: Callable, tasks: Sequence[tuple]) -> Iterator[tuple[int, object] | None]:
        """Run a function on each tuple of arguments, wherever there is room; a task whose worker dies goes to another.

        Yields
        ------
        (int, object) or None
            A task's number and what it returned, in any order; None now and then while nothing is ready. Closing the
            generator takes back what has not begun.

        Raises
        ------
        ScanstageError
            A task fails, or there is no worker or no scheduler any more.
        """
        futures = {self._client.submit(function, *task, resources={identity().resource: 1}, pure=False): number
                   for number, task in enumerate(tasks)}
        alone_since = None
        try:
            while futures:
                done = self._ready(list(futures))
                for future in done:
                    yield futures.pop(future), self._result(future)
                alone_since = None if done or self._somebody() else alone_since or time.monotonic()
                if alone_since and time.monotonic() - alone_since > _NO_WORKER:
                    raise ScanstageError(f"--scheduler: no worker is left at {self._address}; start some with "
                                         f"`{START.format(self._address)}` and give the same command again")
                yield None
        finally:
            with suppress(OSError):  # a scheduler that is gone has nothing to take back
                self._client.cancel(list(futures), force=True)

    def _ready(self, futures: Iterable[Future]) -> list[Future]:
        with suppress(TimeoutError, CancelledError):  # of one that is cancelled its status tells
            wait(futures, timeout=LOOK, return_when="FIRST_COMPLETED")
        return [future for future in futures if future.status in _ENDS]  # one that is "lost" is being done again

    def _somebody(self) -> bool:
        try:
            return bool(self._client.nthreads())
        except (OSError, CommClosedError):
            raise ScanstageError(f"--scheduler: the scheduler at {self._address} is gone; start it and its workers and give the same "
                                 "command again") from None

    def _result(self, future: Future) -> object:
        try:
            return future.result()
        except KilledWorker:
            raise ScanstageError("--scheduler: several workers died of the same piece of work; give them more memory, or ask for fewer "
                                 "voxels") from None
        except MemoryError:
            raise ScanstageError("--scheduler: a worker has not enough memory for its piece of the work; give it more, or ask for fewer "
                                 "voxels") from None
        except CancelledError:
            raise ScanstageError(f"--scheduler: the workers at {self._address} that held the captures died, all of them; start some with "
                                 f"`{START.format(self._address)}` and give the same command again") from None


@contextmanager
def connected(address: str) -> Iterator[Connection]:
    """Connect to a scheduler for as long as a block lasts.

    Raises
    ------
    ScanstageError
        There is none, it has no workers, or they are of another version or Blender.
    """
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.ERROR)  # that a worker died is no news: others do its work
    try:
        client = Client(address, timeout=_ANSWER)
    except (OSError, ValueError, TypeError) as error:
        raise ScanstageError(f"--scheduler: no scheduler answers at {address} ({_first_line(error)}); start one with `python3 "
                             "scripts/scanstage.py scheduler`, and give the address that it prints") from None
    try:
        _check_workers(client, address)
        client.amm.stop()  # the scheduler's habit to drop copies: with a worker that dies the only one of the masks would be gone
        yield Connection(client, address)
    finally:
        client.close()


def _check_workers(client: Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_FIRST_WORKER)
    except TimeoutError:
        raise ScanstageError(f"--scheduler: {address} has no workers; start some with `{START.format(address)}`, on this machine or "
                             "others") from None
    answers = client.run(identity, on_error="return")
    for worker, answer in sorted(answers.items()):
        if isinstance(answer, Exception):
            raise ScanstageError(f"--scheduler: worker {worker} is not one of this program's ({_first_line(answer)}); start it with "
                                 f"`{START.format(address)}`")
        if difference := identity().difference(answer):
            raise ScanstageError(f"--scheduler: worker {worker} has {difference}; give it the same clone and the same Python as this "
                                 "machine, and start it again")


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
