# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The view is turned so that all that is to be seen is seen, and beside what covers it."""

import numpy as np
import pytest

from addon.ui.viewport import frustum_about


@pytest.mark.parametrize("tangents", [[[-0.5, 0.5], [-0.3, 0.3]], [[-0.6, 0.2], [-0.4, 0.35]], [[0.1, 0.7], [-0.7, 0.7]]])
def test_the_nearest_eye_that_sees_all_points(tangents):
    points, tangents = np.random.default_rng(5).normal(size=(200, 3)) * (1, 2, 3) + (4, -5, 6), np.array(tangents)
    eye = frustum_about(points, tangents)
    way = points - eye
    at = way[:, :2] / -way[:, 2:]
    assert (way[:, 2] < 0).all() and (at >= tangents[:, 0] - 1e-9).all() and (at <= tangents[:, 1] + 1e-9).all()
    ends = np.array([at.min(axis=0), at.max(axis=0)]).T
    assert np.isclose(ends, tangents, atol=1e-9).all(axis=1).any()  # along one axis there is no room on either side: nearer is too near
