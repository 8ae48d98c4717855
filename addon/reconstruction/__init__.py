# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The numpy module: geometry, silhouettes, volumetric and active stereo, evaluation. No bpy, no file paths.

Conventions, said once
----------------------
- World: right-handed, z up, metres. Reconstruction happens in the *object frame*: the turntable's frame at angle 0.
- Camera: ``x ~ K [R | t] X``; x right, y down, z forward. The centre of the top-left pixel is ``(0, 0)``, so an image
  ``W`` pixels wide covers ``-0.5 .. W - 0.5``.
- Distortion: ``k1 k2 p1 p2 k3``, as in OpenCV.
- Volumes: indexed ``[x, y, z]``; voxel ``(i, j, k)`` covers ``origin + voxel_size * [i, i + 1) x ...``.
- Angles are radians, colours linear.
"""
