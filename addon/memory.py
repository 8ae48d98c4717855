# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How much memory there is, and how much was used, on every system that Blender runs on."""

import ctypes
import os
import sys


def available_memory() -> int:
    """Return the bytes that a program can still take without swapping; physical memory where only that is known."""
    if sys.platform == "win32":
        return _windows_available()
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass  # not Linux
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def peak_memory() -> int | None:
    """Return the most bytes this process has held so far, or None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None  # Windows
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _windows_available() -> int:
    class MemoryStatus(ctypes.Structure):
        """MEMORYSTATUSEX of the Windows API."""

        _fields_ = [("length", ctypes.c_ulong), ("load", ctypes.c_ulong)] + [
            (name, ctypes.c_ulonglong) for name in ("total", "available", "total_page", "available_page", "total_virtual",
                                                    "available_virtual", "extended")]

    status = MemoryStatus(length=ctypes.sizeof(MemoryStatus))
    ctypes.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status))
    return status.available


class MemoryUse:
    """What this process takes more from now on.

    The system tells a process's peak, and that only grows: where it was higher before, what is used now cannot be told.
    """

    def __init__(self) -> None:
        self._before, self._held = peak_memory(), _held_memory()

    def peak(self) -> int | None:
        """Return the most bytes held since then, less what was held then; None where that is not known."""
        peak = peak_memory()
        if peak is None or self._held is None or peak <= self._before:
            return None
        return peak - self._held


def amount(size: float) -> str:
    """Return bytes as a person says them."""
    return f"{size / 2 ** 30:.1f} GiB" if size >= 2 ** 30 else f"{size / 2 ** 20:.0f} MiB"


def _held_memory() -> int | None:
    """Return the bytes that this process holds now; None where the system does not tell."""
    try:
        with open("/proc/self/statm", encoding="ascii") as line:
            return int(line.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None  # not Linux
