# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxels that shadows carved stand beside the result, coloured by light, and go with it."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.reconstruction.color import linear_to_srgb
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.outcome import VoxelLayer
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.carved import CARVED_NAME, LIGHT_COLORS
from addon.results.folder import Result, read_result, write_result
from addon.results.layers import rows_of
from addon.results.present import results_collection, show_result

GRID = VoxelGrid((-0.1, -0.1, 0.0), 0.02, (10, 11, 12))


@pytest.fixture
def found(tmp_path):
    """A block with a pit of 4 x 3 x 5 voxels, each carved by a view, a light and a round of its own place, in no order."""
    occupied = np.ones(GRID.shape, bool)
    occupied[3:7, 4:7, 7:] = False
    volume = SparseVolume.from_dense(GRID, occupied)
    voxels = np.random.default_rng(5).permutation(np.argwhere(~occupied)).astype(np.int32)
    values = {"view": voxels[:, 0].astype(np.uint16), "light": voxels[:, 2].astype(np.uint16), "round": voxels[:, 1].astype(np.uint16)}
    report = {"method": "shadow-carving", "carved_by": {"views": ["0001"], "lights": [f"light-{i}" for i in range(12)]}}
    return Result(tmp_path / "result", report, volume, extract_surface(volume), None, {"carved": VoxelLayer(voxels, values)})


def by_name(scene):
    return {member.name: member for member in results_collection(scene).objects}


def face_values(mesh, name):
    values = np.zeros(len(mesh.polygons), np.int32)
    mesh.attributes[name].data.foreach_get("value", values)
    return values


def test_every_face_tells_who_carved_its_voxel(empty_scene, found):
    show_result(empty_scene, found)
    shown = by_name(empty_scene)[CARVED_NAME]
    mesh = shown.data
    assert len(mesh.polygons) == 2 * (4 * 3 + 3 * 5 + 5 * 4)
    # A voxel's centre lies half a voxel behind the middle of its face.
    inside = np.array([face.center - 0.5 * GRID.voxel_size * face.normal for face in mesh.polygons])
    voxels = np.floor((inside - GRID.origin) / GRID.voxel_size).astype(int)
    for name, axis in (("view", 0), ("light", 2), ("round", 1)):
        assert mesh.attributes[name].domain == 'FACE'
        np.testing.assert_array_equal(face_values(mesh, name), voxels[:, axis])
    colors = np.zeros((len(mesh.loops), 4), np.float32)
    mesh.color_attributes.active_color.data.foreach_get("color", colors.ravel())
    srgb = np.rint(255 * linear_to_srgb(colors[::4, :3])).astype(np.uint8)
    assert ["%02x%02x%02x" % tuple(color) for color in srgb] == [LIGHT_COLORS[z % 8] for z in voxels[:, 2]]
    assert shown["lights"].split(", ") == found.report["carved_by"]["lights"]


def test_it_stands_beyond_the_result_in_a_collection_that_renders_skip(empty_scene, found):
    result = show_result(empty_scene, found)
    bpy.context.view_layer.update()
    shown = by_name(empty_scene)[CARVED_NAME]
    width = 10 * GRID.voxel_size
    assert np.allclose(shown.matrix_world.translation - result.matrix_world.translation, (1.6 * width, 0, 0), atol=1e-6)
    assert results_collection(empty_scene).hide_render


@pytest.mark.parametrize("layers", ["none", "empty", "another"])
def test_a_result_without_takes_the_earlier_away(empty_scene, found, layers):
    nothing = VoxelLayer(np.zeros((0, 3), np.int32), {name: np.zeros(0, np.uint16) for name in ("view", "light", "round")})
    other = VoxelLayer(found.layers["carved"].voxels, {"light": found.layers["carved"].values["light"]})
    show_result(empty_scene, found)
    show_result(empty_scene, found)
    assert by_name(empty_scene).keys() == {"Result", CARVED_NAME}
    show_result(empty_scene, replace(found, layers={"none": {}, "empty": {"carved": nothing}, "another": {"carved": other}}[layers]))
    assert by_name(empty_scene).keys() == {"Result"}
    assert bpy.data.meshes.keys() == ["Result"]


def test_it_survives_the_folder(empty_scene, found):
    write_result(found.folder, volume=found.volume, surface=found.surface, colors=None, report=found.report,
                 preview=np.zeros((4, 4, 3), np.uint8), layers=found.layers)
    show_result(empty_scene, found)
    lights = face_values(by_name(empty_scene)[CARVED_NAME].data, "light")
    show_result(empty_scene, read_result(found.folder))
    np.testing.assert_array_equal(face_values(by_name(empty_scene)[CARVED_NAME].data, "light"), lights)


def test_rows_are_those_of_the_layer(found):
    layer = found.layers["carved"]
    everywhere = np.argwhere(np.ones(GRID.shape, bool)).astype(np.int32)
    row_of = {tuple(voxel): row for row, voxel in enumerate(layer.voxels)}
    assert list(rows_of(layer, everywhere, GRID)) == [row_of.get(tuple(voxel), -1) for voxel in everywhere]
