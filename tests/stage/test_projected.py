# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture that is drawn at the end of a projector's frustum is the pattern of the frame, pixel by pixel."""

import numpy as np
import pytest

from addon.reconstruction.active.patterns import make_patterns
from addon.stage import readback, staging
from addon.stage.projected import projected_pictures

SIZE = (24, 16)


def pixels_of(image):
    width, height = image.size
    values = np.zeros(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, 4)[..., :3]


@pytest.mark.parametrize("preset, name, options", [("gray-code", "gray-code", {"axes": "both"}), ("depth-sensor", "speckle", {}),
                                                   ("phase-shift", "phase-shift", {"axes": "rows"})])
def test_what_is_drawn_is_what_the_pattern_says_there(empty_scene, preset, name, options):
    staging.build(empty_scene, preset, "knot", {"views": 1, "projector_x": SIZE[0], "projector_y": SIZE[1], "resolution_x": 64,
                                                "resolution_y": 48, "projector_k1": -0.05, **options})
    plan = readback.plan_of(empty_scene)
    patterns = {pattern.id: pattern.image for pattern in make_patterns(name, SIZE, options)}
    drawn = 0
    for frame in plan.frames:
        empty_scene.frame_set(frame.number)
        pictures = list(projected_pictures(empty_scene))
        assert len(pictures) == (frame.pattern is not None)
        for picture in pictures:
            projector = next(iter(plan.projectors.values()))
            pixels, _ = projector.project(picture.corners.mean(axis=1))  # of the triangles' middles
            place = picture.places.mean(axis=1)
            values = pixels_of(picture.image)
            height, width = values.shape[:2]
            found = values[np.minimum((place[:, 1] * height).astype(int), height - 1), np.minimum((place[:, 0] * width).astype(int), width - 1)]
            at = np.rint(pixels).astype(int)
            image = patterns[frame.pattern]
            clear = (np.abs(pixels - at) < 0.3).all(axis=1) & (at >= 0).all(axis=1) & (at < SIZE).all(axis=1)
            expected = image[at[clear, 1], at[clear, 0]] / (1.0 if image.dtype.kind == "f" else np.iinfo(image.dtype).max)
            assert clear.sum() > 20
            assert found[clear, 0] == pytest.approx(expected, abs=0.01)
            drawn += 1
    assert drawn >= 1
