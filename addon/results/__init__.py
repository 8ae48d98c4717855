# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a reconstruction leaves behind: result folders, exchange files, and meshes in Blender.

`ply` and `folder` need no Blender; the other modules of this package import bpy.
"""
