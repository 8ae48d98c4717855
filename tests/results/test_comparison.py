# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Truth, result and error side by side: the right size, in the right order, with nothing left behind."""

import bpy
import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.results.comparison import add_comparison, remove_comparison, render_comparison
from addon.results.objects import add_polygon_mesh, add_voxel_mesh
from addon.results.studio import RIGHT, UP

pytestmark = pytest.mark.usefixtures("empty_scene")

FRAME = np.array([(0, -1, 0, 5.0), (1, 0, 0, -3.0), (0, 0, 1, 2.0), (0, 0, 0, 1)])
KINDS = ("scenes", "objects", "meshes", "materials", "curves", "lights", "cameras", "worlds", "collections", "actions")


def inventory():
    return {kind: sorted(getattr(bpy.data, kind).keys()) for kind in KINDS}


@pytest.fixture
def pair(ball):
    """Return a red box as truth and a green ball of voxels as result, both turned and moved by FRAME."""
    grid, surface = ball
    home = bpy.context.scene.collection
    box = np.stack(np.meshgrid((-0.9, 0.9), (-0.9, 0.9), (-0.9, 0.9), indexing="ij"), axis=-1).reshape(-1, 3)
    sides = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    truth = add_polygon_mesh("Truth", box, sides, collection=home, frame=FRAME)
    rgb = np.tile((0.0, 0.5, 0.0), (len(surface.voxels), 1))
    return truth, add_voxel_mesh("Result", surface, rgb, collection=home, grid=grid, frame=FRAME, method="visual-hull")


def compared(pair, value=1.0, **options):
    truth, result = pair
    return add_comparison(truth, result, np.full(len(result.data.polygons), value), 1.0, scene=bpy.context.scene, **options)


def placed(target):
    """Return the vertices of a mesh object in the world."""
    matrix = np.array(target.matrix_world)
    return np.array([v.co for v in target.data.vertices]) @ matrix[:3, :3].T + matrix[:3, 3]


def test_the_three_stand_in_a_row_on_the_floor(pair):
    row = compared(pair)
    bpy.context.view_layer.update()
    truth, result, error = (row.objects[f"Comparison {name}"] for name in ("Truth", "Result", "Error"))
    # Single precision, and means over a thousand vertices.
    np.testing.assert_allclose(np.diff([placed(o).mean(axis=0) @ RIGHT for o in (result, error)]),
                               -np.diff([placed(o).mean(axis=0) @ RIGHT for o in (result, truth)]), atol=1e-4)
    spans = [(points.min(), points.max()) for points in (placed(o) @ RIGHT for o in (truth, result, error))]
    assert spans[0][1] < spans[1][0] < spans[1][1] < spans[2][0]  # left to right, and apart
    for target in (truth, result, error):
        np.testing.assert_allclose(np.array(target.matrix_world)[:3, :3], FRAME[:3, :3], atol=1e-6)
    assert min(placed(truth)[:, 2].min(), placed(result)[:, 2].min()) == pytest.approx(0, abs=1e-6)
    # What belongs together is together: the two copies differ by a shift along the row alone.
    shift = placed(truth).mean(axis=0) - placed(result).mean(axis=0)
    np.testing.assert_allclose(shift - (shift @ RIGHT) * RIGHT, 0, atol=1e-4)


def test_labels_stay_clear_of_the_objects_and_above_the_floor(pair):
    row = compared(pair, signed=True)
    bpy.context.view_layer.update()
    objects = np.concatenate([placed(o) for o in row.objects if o.type == 'MESH' and o.name != "Comparison Legend"])
    for label in (o for o in row.objects if o.type == 'FONT'):
        matrix = np.array(label.matrix_world)
        corners = np.array(label.bound_box) @ matrix[:3, :3].T + matrix[:3, 3]
        assert corners[:, 2].min() > 0
        if "Tick" in label.name:
            assert (corners @ RIGHT).min() > (objects @ RIGHT).max()
        else:
            assert (corners @ UP).max() < (objects @ UP).min()
    words = {o.data.body for o in row.objects if o.type == 'FONT'}
    # The box is 1.8 m wide, of which 1 m is 56 %; a voxel of the ball measures 2 m / 24.
    assert {"Truth", "Result", "Error", "1 m", "0", "\u22121 m", "1.8 m across", "visual-hull, 83 mm voxels",
            "1 m = 56 % of the size"} <= words


def test_it_shares_meshes_and_goes_without_a_trace(pair):
    before = inventory()
    row = compared(pair)
    assert row.objects["Comparison Result"].data == pair[1].data
    assert row.objects["Comparison Error"].data == pair[1].data
    compared(pair)
    assert [name for name in bpy.data.collections.keys() if "Comparison" in name] == ["Comparison"]
    remove_comparison()
    assert inventory() == before


def test_bad_distances_leave_nothing(pair):
    before = inventory()
    with pytest.raises(ValueError, match="finite"):
        compared(pair, np.nan)
    assert inventory() == before


def test_the_picture_shows_truth_result_and_error_and_nothing_else_changes(pair, tmp_path):
    scene = bpy.context.scene
    scene.render.resolution_x, scene.view_settings.view_transform = 123, 'Raw'
    compared(pair)
    before = inventory()
    path = tmp_path / "picture.png"
    path.write_text("older")
    render_comparison(path, size=(300, 112))
    assert inventory() == before
    assert (bpy.context.scene, scene.render.resolution_x, scene.view_settings.view_transform) == (scene, 123, 'Raw')
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]
    picture = cv2.imread(str(path))[..., ::-1].astype(int)
    assert picture.shape == (112, 300, 3)
    assert picture[0].min() > 200  # a light background up to the edges, which does not clip
    assert picture[0].max() < 255
    red, green, blue = picture.transpose(2, 0, 1)
    greenish = np.nonzero((green > red + 60) & (green > blue + 60))[1]
    yellowish = np.nonzero((red > 180) & (green > 150) & (blue < 90))[1]  # viridis at its limit
    assert len(greenish) > 300
    assert len(yellowish) > 300
    assert 100 < np.median(greenish) < np.median(yellowish)


def test_errors_are_one_sentence(pair, tmp_path):
    with pytest.raises(ScanstageError, match="there is no comparison"):
        render_comparison(tmp_path / "picture.png")
    compared(pair)
    before = inventory()
    with pytest.raises(ScanstageError, match="cannot be written"):
        render_comparison(tmp_path / "none" / "picture.png", size=(32, 16))
    assert inventory() == before
