# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Built-in objects on the turntable, rendered once and seen in as many views, and under as many lights, as wanted."""


def rendered(name, folder, progress, views, preset="turntable", options=None, shadow_options=None, change=None):
    """Capture a built-in object on the turntable, or take up the capture that is there.

    Parameters
    ----------
    name : str
        Of the built-in object.
    folder : Path
    progress : callable
    views : int
        Poses of the table.
    preset : str
        Of the stage, one with poses of a table.
    options : mapping, optional
        Of the preset.
    shadow_options : mapping, optional
        As `addon.captures.scan.load_scan` takes them: {} finds shadows.
    change : callable, optional
        ``change(scene)`` is called on the stage before it is captured.

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
        build(bpy.context.scene, preset, name, {"views": views, **(options or {})})
        if change:
            change(bpy.context.scene)
        drain(capture_frames(bpy.context.scene, folder), progress)
    return load_scan(folder, progress=progress, shadow_options=shadow_options), read_ply(folder / TRUTH)


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


def under_fewer_lights(scan, lights):
    """Return a scan in which every view has ``lights`` of its pictures under single lights, as evenly spread.

    What is a shadow stays as it was found, with the help of the picture under all lights.

    Raises
    ------
    ValueError
        The number of lights of a view is not a multiple of ``lights``.
    """
    from dataclasses import replace

    from addon.reconstruction.scan import Scan

    return Scan(tuple(replace(view, lit=view.lit[::_every(view, lights)], shadows=_every_shadow(view, _every(view, lights)))
                      for view in scan.views), scan.bounds)


def _every(view, lights):
    if len(view.lit) % lights:
        raise ValueError(f"{lights} lights cannot be spread evenly over {len(view.lit)}")
    return len(view.lit) // lights


def _every_shadow(view, step):
    """Return a view's shadows of every so many lights."""
    from addon.reconstruction.shadows import ShadowMasks

    bits = sum((view.shadows.of(light).astype(view.shadows.bits.dtype) << number
                for number, light in enumerate(range(0, len(view.lit), step))), start=view.shadows.bits * 0)
    return ShadowMasks(bits, view.shadows.decidable)


def without_texture(scene):
    """Give what is staged one matte colour."""
    from addon.stage.materials import matte
    from addon.stage.readback import staged_objects

    for mesh in {o.data for o in staged_objects(scene) if o.type == "MESH"}:
        mesh.materials.clear()
        mesh.materials.append(matte("plain", (0.5, 0.46, 0.4)))


def paint_a_patch(scene):
    """Paint a wide patch of the staged object's right side with albedo 0.02: there, light is as dark as a shadow."""
    import numpy as np

    from addon.stage.materials import matte
    from addon.stage.readback import staged_objects

    mesh = next(o for o in staged_objects(scene) if o.type == "MESH").data
    mesh.materials.append(matte("paint", (0.02, 0.02, 0.02)))
    middles = np.zeros(3 * len(mesh.polygons), np.float32)
    mesh.polygons.foreach_get("center", middles)
    x, y, z = middles.reshape(-1, 3).T
    patch = (x > 0) & (np.abs(y) < 0.05) & (np.abs(z - z.mean()) < 0.05)
    mesh.polygons.foreach_set("material_index", patch.astype(np.int32))
