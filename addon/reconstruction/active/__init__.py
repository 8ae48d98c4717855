# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Active stereo: a projector, or a laser, takes the place of one of two cameras and says which point is which.

`patterns` makes what is projected, `sequences` finds a view's pictures by their patterns, the decoders (`gray_code`,
`phase_shift`, `stripe`) turn them into a correspondence map, `triangulation` turns that into points, and `free_space`
points into voxels.

A projector is a `Camera` run backwards: its pixel ``(column, row)`` has its centre at whole numbers, and a pattern's
image is what it shows there.
"""
