# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Built-in objects on the turntable, rendered once and seen in as many views as wanted."""


def rendered(name, folder, progress, views):
    """Capture a built-in object on the turntable, or take up the capture that is there.

    Parameters
    ----------
    name : str
        Of the built-in object.
    folder : Path
    progress : callable
    views : int
        Poses of the table.

    Returns
    -------
    scan : addon.reconstruction.scan.Scan
    truth : addon.reconstruction.mesh.TriangleMesh
    """
    import bpy

    from addon.captures.scan import load_scan
    from addon.cli.progress_bar import drain, muted_stdout
    from addon.render.capture import TRUTH, capture_frames
    from addon.results.blend import new_file
    from addon.results.ply import read_ply
    from addon.stage.staging import build

    with muted_stdout():
        new_file()
        build(bpy.context.scene, "turntable", name, {"views": views})
        drain(capture_frames(bpy.context.scene, folder), progress)
    return load_scan(folder, progress=progress), read_ply(folder / TRUTH)


def thinned(scan, views):
    """Return a scan with ``views`` of a scan's views, as evenly spread: the poses of a turn in 72 steps hold those of one in 24.

    Raises
    ------
    ValueError
        The number of views is not a multiple of ``views``.
    """
    from addon.reconstruction.scan import Scan

    if len(scan.views) % views:
        raise ValueError(f"{views} views cannot be spread evenly over {len(scan.views)}")
    return Scan(scan.views[::len(scan.views) // views], scan.bounds)
