# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a rig will see, before a picture is taken: from the true object, the cameras and the lights alone.

- `tessellation`: an object in triangles of a size that can be worked on while a mouse moves.
- `outlines`: silhouettes of a mesh, from its contour edges.
- `depth_buffer`: which points of a mesh a device sees.
- `coverage`: how many views, lights and projector pixels reach each triangle, and how well its depth is known.
- `preview_hull`: the visual hull that the rig will carve.
"""
