# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports as lines of text for stdout."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..memory import amount
from ..options import Option
from ..reconstruction.methods import COMMON_COUNTS


def option_lines(options: Iterable[Option]) -> list[str]:
    """Return one line an option: name, default with unit, what it does, choices."""
    lines = []
    for option in options:
        lines.append(f"  {option.name} = {option.show(option.default)}: {option.description}")
        lines += [f"      {choice}: {meaning}" for choice, meaning in (option.choices or {}).items()]
    return lines


def reconstruction_lines(folder: Path, report: dict) -> list[str]:
    """Return what a reconstruction found, for a reader."""
    counts, grid, memory = report["counts"], report["grid"], report["memory"]
    shape = " x ".join(str(n) for n in grid["shape"])
    lines = [
        f"{folder}: {report['method']}, {shape} voxels of {grid['voxel_size']:.6g}",
        f"  occupied voxels     {counts['occupied']:,} (surface {counts['surface']:,}, of which no view sees {counts['unseen']:,})",
        *(f"  {name.replace('_', ' '):<20}{count:,}" for name, count in counts.items() if name not in COMMON_COUNTS),
        "  seconds             " + ", ".join(f"{name} {seconds:.2f}" for name, seconds in report["seconds"].items()),
    ]
    lines.append(f"  memory              predicted {amount(memory['predicted'])}"
                 + (f", used {amount(memory['used'])}" if memory["used"] is not None else "")
                 + (f" (the whole process {amount(report['peak_memory'])})" if report["peak_memory"] else ""))
    ious = report["silhouette_iou"]
    if ious["mean"] is not None:
        worst = min(ious["views"], key=ious["views"].get)
        lines.append(f"  silhouette IoU      mean {ious['mean']:.4f}, lowest {ious['views'][worst]:.4f} (frame {worst})")
    return lines + [f"  warning: {warning}" for warning in report["warnings"]]


def calibration_lines(folder: Path, report: dict) -> list[str]:
    """Return how well each device was calibrated, for a reader."""
    lines = [f"{folder}: {len(report['devices'])} device(s) calibrated"]
    for name, device in report["devices"].items():
        worst = max(device["views"], key=device["views"].get)
        lines.append(f"  {name:<19} RMS {device['rms']:.3f} px in {len(device['views'])} poses (worst {device['views'][worst]:.3f}, frame "
                     f"{worst}), focal length {device['K'][0][0]:.2f} +- {device['deviations'][0]:.2f} px")
    if table := report["turntable"]:
        error = max(map(abs, table["angle_errors"].values()))
        lines.append(f"  turntable           {table['poses']} poses, turned by at most {error:.3f} degrees more or less than commanded")
    return lines + [f"  warning: {warning}" for warning in report["warnings"]]


def measure_lines(measures: dict) -> list[str]:
    """Return an evaluation, one measure a line."""
    return [f"  {group + '.' + name:<30} {_number(value)}" for group, found in measures.items() for name, value in found.items()]


def _number(value: float | int | None) -> str:
    if value is None:
        return "-"
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"
