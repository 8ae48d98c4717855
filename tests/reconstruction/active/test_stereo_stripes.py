# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Two cameras before coloured stripes whose projector nobody has calibrated."""

from dataclasses import replace

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.stereo_stripes import common_edges
from addon.reconstruction.methods import METHODS
from addon.reconstruction.scan import ProjectedPicture, Scan, View
from tests.projection import sight
from tests.rigs import camera_at
from tests.stripes import BALL, PROJECTOR, SAMPLES, WALL, colored_picture

BOX = np.array([[-0.6, -0.5, -0.15], [0.6, 0.2, 0.15]])


def uncalibrated(place, surfaces, seed):
    """Return the view of a camera at a place, whose pictures know nothing of the projector."""
    camera = camera_at(place, focal=1600.0, size=(1120, 120))
    pattern, = make_patterns("color-stripes", PROJECTOR.size)
    seen = sight(camera.scaled(SAMPLES), PROJECTOR, surfaces, 1.0)
    image = colored_picture(seen, np.full(3, 0.8), pattern, crosstalk=np.eye(3), seed=seed)
    shot = ProjectedPicture(f"shot-{seed}", pattern.fields, None, None, lambda: image)
    return View(f"{seed:04d}", camera, None, lambda: image, projected=(shot,))


@pytest.mark.parametrize("turned", [False, True])
def test_points_of_both_cameras_lie_on_the_surface(turned):
    places = [(-0.25, -2.0, 0.0), (0.2, -2.0, 0.02)]
    views = [uncalibrated(place, [BALL, WALL], seed) for seed, place in enumerate(places[::-1] if turned else places)]
    cloud = METHODS["color-stripes"].measure(Scan(tuple(views), BOX)).cloud
    error = np.minimum(np.abs(np.linalg.norm(cloud.positions, axis=1) - 0.35), np.abs(cloud.positions[:, 1]))
    pixel = 2.0 ** 2 / (1600 * 0.45)  # metres of depth for a pixel of disparity, at the wall
    assert len(cloud) > 5000 and set(cloud.view) == {0, 1}
    assert np.median(error) < 0.3 * pixel and (error < 2 * pixel).mean() > 0.98


def test_edges_are_common_only_if_both_pictures_show_them_once_in_a_row():
    first = np.array([0, 0, 0, 1]), np.array([5.0, 9.0, 13.0, 7.0]), np.array([15.5, 23.5, 23.5, 31.5])
    second = np.array([0, 0, 2]), np.array([2.0, 3.0, 4.0]), np.array([15.5, 23.5, 31.5])
    rows, here, there = common_edges(first, second)
    assert (rows.tolist(), here.tolist(), there.tolist()) == ([0], [5.0], [2.0])


def test_one_camera_without_a_projector_is_refused():
    view = uncalibrated((0.0, -2.0, 0.0), [WALL], 0)
    with pytest.raises(ScanstageError, match="its stripes' projector is not calibrated, and no second camera"):
        METHODS["color-stripes"].measure(Scan((view, replace(view, name="again")), BOX))


def test_stripes_that_number_rows_need_the_projector():
    view = uncalibrated((0.0, -2.0, 0.0), [WALL], 0)
    shot = replace(view.projected[0], pattern={**view.projected[0].pattern, "axis": "row"})
    with pytest.raises(ScanstageError, match="two cameras without a calibrated projector need columns"):
        METHODS["color-stripes"].measure(Scan((replace(view, projected=(shot,)),), BOX))
