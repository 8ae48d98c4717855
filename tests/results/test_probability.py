# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result with probabilities is cut where the user says, and only its surface is made again."""

import bpy
import numpy as np
import pytest

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.outcome import VoxelLayer
from addon.reconstruction.volumetric.coloring import NEUTRAL
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.folder import Result, read_result, write_result
from addon.results.present import show_above, show_result, shown_probabilities
from addon.results.probability import cut, has_probabilities, threshold_of

GRID = VoxelGrid((-0.1, -0.1, 0.0), 0.025, (8, 8, 8))


def result(folder):
    """Return a block whose probability falls from 1 at the bottom, listed to the height of 6 voxels; the rest nobody saw."""
    voxels = np.argwhere(np.ones((8, 8, 6), bool)).astype(np.int32)
    probability = (1 - voxels[:, 2] / 6).astype(np.float32)
    values = {"probability": probability, **{name: np.float32(voxels[:, 2]) / 10 for name in ("red", "green", "blue")}}
    occupied = np.ones(GRID.shape, bool)
    occupied[tuple(voxels[probability <= 0.5].T)] = False
    volume = SparseVolume.from_dense(GRID, occupied)
    report = {"method": "probabilistic-carving", "options": {"least_probability": 0.5, "prior": 0.65}}
    return Result(folder, report, volume, extract_surface(volume), None, {"probability": VoxelLayer(voxels, values)})


@pytest.mark.parametrize("threshold, height", [(0.0, 6), (0.3, 5), (0.5, 3), (0.9, 1), (1.0, 0)])
def test_a_cut_is_the_surface_of_what_is_above(tmp_path, threshold, height):
    part = cut(result(tmp_path), threshold)
    expected = np.ones(GRID.shape, bool)
    expected[:, :, height:6] = False
    same = extract_surface(SparseVolume.from_dense(GRID, expected))
    np.testing.assert_array_equal(part.surface.quads, same.quads)
    np.testing.assert_array_equal(part.surface.vertices, same.vertices)
    z = part.surface.voxels[:, 2]
    listed = z < 6
    np.testing.assert_allclose(part.probability, np.where(listed, 1 - z / 6, 0.65), atol=1e-6)
    np.testing.assert_allclose(part.rgb, np.where(listed, z / 10, NEUTRAL)[:, None].repeat(3, axis=1), atol=1e-6)


def test_probabilities_survive_the_folder(tmp_path):
    made = result(tmp_path / "result")
    write_result(made.folder, volume=made.volume, surface=made.surface, colors=None, report=made.report,
                 preview=np.zeros((4, 4, 3), np.uint8), layers=made.layers)
    found = read_result(made.folder)
    assert has_probabilities(found) and threshold_of(found) == 0.5
    np.testing.assert_array_equal(cut(found, 0.7).surface.quads, cut(made, 0.7).surface.quads)


def test_the_object_stays_and_its_mesh_changes(empty_scene, tmp_path):
    made = result(tmp_path)
    shown = show_result(empty_scene, made)
    assert shown_probabilities(empty_scene) == shown
    shown.location.x += 1
    bpy.context.view_layer.update()
    before = shown.matrix_world.copy()
    for threshold, ramp in ((0.9, True), (0.1, False), (0.5, True)):
        show_above(shown, made, threshold, ramp=ramp)
        part = cut(made, threshold)
        values = np.zeros(len(part.surface.quads), np.float32)
        shown.data.attributes["probability"].data.foreach_get("value", values)
        np.testing.assert_array_equal(values, part.probability[part.surface.face_voxel])
        material, = shown.data.materials
        assert material.name == ("Scanstage Probability" if ramp else "Scanstage Voxels")
    assert shown.matrix_world == before
    assert len(bpy.data.meshes) == 1 and [material.name for material in bpy.data.materials] == ["Scanstage Probability"]


def test_the_ramp_is_what_renders_show(empty_scene, tmp_path):
    shown = show_result(empty_scene, result(tmp_path))
    ramp = next(node for node in shown.data.materials[0].node_tree.nodes if node.bl_idname == "ShaderNodeValToRGB").color_ramp
    attribute = next(node for node in shown.data.materials[0].node_tree.nodes if node.bl_idname == "ShaderNodeAttribute")
    assert attribute.attribute_name == "probability" and attribute.attribute_type == 'GEOMETRY'
    low, high = (np.array(ramp.evaluate(value)[:3]) for value in (0.0, 1.0))
    assert low.mean() < 0.2 < high.mean()  # viridis: from dark violet to yellow


def test_other_results_have_no_slider(empty_scene, tmp_path):
    made = result(tmp_path)
    plain = Result(tmp_path, {"method": "visual-hull"}, made.volume, made.surface, None)
    assert not has_probabilities(plain)
    show_result(empty_scene, plain)
    assert shown_probabilities(empty_scene) is None
