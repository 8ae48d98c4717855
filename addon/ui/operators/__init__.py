# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons. Each gathers what the panel set, calls one function of the project, and reports.

One module for each station of the work: `stage`, `capture`, `reconstruct`, `evaluate`; `requirements` is what they all ask first.
"""

import bpy

from . import capture, evaluate, reconstruct, stage

register, unregister = bpy.utils.register_classes_factory(stage.CLASSES + capture.CLASSES + reconstruct.CLASSES + evaluate.CLASSES)
