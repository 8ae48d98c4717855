# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a rig's devices are and where they stand, from pictures of a board: cameras, projectors, turntable, light, laser.

`board` draws and finds boards; `camera` calibrates one device from corners, `projector` finds the corners in a projector's own
pixels, `rig` relates the devices and adjusts all of them together. `turntable`, `light` and `laser` need calibrated cameras.
"""
