# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What each measure is, for panels and pages: its title, what kind of number it is, and what it says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """What a measure is written as."""

    COUNT = "count"
    SHARE = "share"
    LENGTH = "length"
    VOLUME = "volume"


@dataclass(frozen=True)
class Explained:
    """A measure: its title, its kind, and what it says, without a full stop."""

    label: str
    kind: Kind
    meaning: str


EXPLAINED: Mapping[str, Explained] = {
    "result": Explained("Volume", Kind.VOLUME, "of the result"),
    "truth": Explained("True volume", Kind.VOLUME, "of the true object"),
    "excess": Explained("Excess", Kind.SHARE, "what the result has too much, as a share of the true volume"),
    "loss": Explained("Loss", Kind.SHARE, "what the result lacks, as a share of the true volume"),
    "iou": Explained("Overlap (IoU)", Kind.SHARE, "what both have, as a share of what either has"),
    "truth_voxels_removed": Explained("True voxels lost", Kind.COUNT, "wholly inside the true object: 0 for a conservative method"),
    "accuracy_90": Explained("90 % within", Kind.LENGTH, "nine tenths of the result are nearer to the true surface"),
    "completeness": Explained("Completeness", Kind.SHARE, "of the true surface, that the result comes near to"),
    "chamfer": Explained("Chamfer distance", Kind.LENGTH, "mean distance from the result to the truth, plus that back"),
    "hausdorff": Explained("Worst (Hausdorff)", Kind.LENGTH, "the greatest distance in either direction"),
    "f_score": Explained("F-score", Kind.SHARE, "completeness and the share of the result near the truth, as one number"),
    "rms": Explained("RMS distance", Kind.LENGTH, "of the result from the true surface"),
    "count": Explained("Points", Kind.COUNT, "that were measured"),
    "median": Explained("Median distance", Kind.LENGTH, "of the points from the true surface"),
}
"""By the names in reports."""
