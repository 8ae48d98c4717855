# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: builds a rig of ordinary Blender objects round an object, plans its captures on the timeline, reads it back.

- `staging`: builds and removes a stage.
- `presets`: the table of rigs, one module each; `rig` and, for active stereo, `scanner`: what they share.
- `objects`: what can stand on the turntable; `materials`: how it looks.
- `devices`: cameras, lights, platters and backdrops as objects; `timeline`: what changes from frame to frame.
- `projector`, `projection`, `laser`, `board`: projectors, their patterns, laser lines and calibration boards; `nodes`: formulas.
- `scene_settings`: the settings that make a picture a measurement; `ownership`: whose is what.
- `readback`: exact cameras, the plan and the true object, out of any scene with a stage.
- `evaluated`: the geometry that a render sees.
"""

from .objects import BUILTINS as BUILT_IN_OBJECTS
from .presets import PRESETS
from .readback import CapturePlan, camera_of, plan_of, projector_of, truth_mesh
from .staging import build, remove

__all__ = ["BUILT_IN_OBJECTS", "PRESETS", "CapturePlan", "build", "camera_of", "plan_of", "projector_of", "remove", "truth_mesh"]
