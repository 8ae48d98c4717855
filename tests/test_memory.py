# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory is measured in bytes, by whatever the system offers."""

import builtins
import io
import os
import subprocess
import sys

import numpy as np
import pytest

from addon.memory import available_memory, peak_memory

MEGABYTE = 1 << 20
POSIX = pytest.mark.skipif(os.name != "posix", reason="asks a POSIX system")


@POSIX
def test_what_is_available_lies_within_what_there_is():
    assert 16 * MEGABYTE < available_memory() <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def offer(monkeypatch, meminfo: str | None) -> None:
    def opened(path, *args, **kwargs):
        if meminfo is None:
            raise FileNotFoundError(path)
        return io.StringIO(meminfo)

    monkeypatch.setattr(builtins, "open", opened)


@POSIX
def test_linux_is_asked_for_what_it_can_give_without_swapping(monkeypatch):
    offer(monkeypatch, "MemTotal:       32000000 kB\nMemFree:          1000 kB\nMemAvailable:   20000000 kB\n")
    assert available_memory() == 20_000_000 * 1024


@POSIX
@pytest.mark.parametrize("meminfo", [None, "MemTotal:       32000000 kB\n"])
def test_elsewhere_it_is_the_machines_memory(monkeypatch, meminfo):
    offer(monkeypatch, meminfo)
    assert available_memory() == os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@POSIX
def test_the_peak_holds_what_was_held_and_let_go():
    """In a process of its own, whose peak begins as that of the one that started it."""
    script = ("import numpy, addon.memory as m; more = m.peak_memory() + (128 << 20); numpy.ones(more, numpy.uint8); "
              "print(more, m.peak_memory())")
    held, peak = map(int, subprocess.run([sys.executable, "-c", script], capture_output=True, check=True, text=True).stdout.split())
    assert held <= peak < held + 256 * MEGABYTE  # with the interpreter and numpy


def test_where_the_system_does_not_tell_there_is_no_peak(monkeypatch):
    monkeypatch.setitem(sys.modules, "resource", None)
    assert peak_memory() is None


def test_the_peak_is_at_least_what_is_held_now():
    if peak_memory() is None:
        pytest.skip("this system does not tell")
    held = np.ones(64 * MEGABYTE, np.uint8)
    assert peak_memory() > held.nbytes
