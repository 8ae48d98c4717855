# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the experiments on carving by colour share: a small capture under the rig of voxel coloring, and what a result lost of it."""

from dataclasses import dataclass

from color_figures import against
from turntable_captures import rendered

from addon.reconstruction import methods
from addon.reconstruction.preview import render_preview

from . import drawing

OBJECT, VIEWS, VOXELS = "dented-sphere", 24, 80
SMALL = {"resolution_x": 320, "resolution_y": 240}


@dataclass(frozen=True)
class Outcome:
    """A result compared with the truth.

    Parameters
    ----------
    found : methods.Reconstruction
    lost : float
        Share of the truth's surface voxels that are not in the result.
    excess : float
        What it has too much, as a share of the truth's volume.
    """

    found: methods.Reconstruction
    lost: float
    excess: float

    @property
    def colored(self):
        """How many voxels got a colour from the pictures."""
        return self.found.report["counts"]["coloured"]


def captured(out, material, progress):
    """Return the scan of the object under the rig of voxel coloring, in one of its materials, and the truth."""
    return rendered(OBJECT, out / "captures" / f"colored-{material}", progress, VIEWS, preset="voxel-coloring",
                    options={**SMALL, "material": material})


def outcome(scan, truth, method, options, progress, voxels=VOXELS):
    """Return what a method makes of a scan, compared with the truth."""
    found = methods.reconstruct(scan, method, voxels=voxels, options=options, progress=progress)
    return Outcome(found, *against(found.volume, truth))


def preview(panel, made, title):
    """Draw a result as a preview, and under its title what it lost and has too much."""
    panel.imshow(render_preview(made.found.surface, made.found.volume.grid, made.found.colors.rgb, size=(480, 400)))
    panel.set_title(f"{title}\nlost {made.lost:.1%}, excess {made.excess:.1%}", fontsize=10)
    drawing.bare(panel)
