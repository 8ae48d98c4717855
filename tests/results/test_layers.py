# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers: what a method says of chosen voxels comes back as it was written, and nothing else is read."""

import json

import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.outcome import VoxelLayer
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.folder import REPORT, read_result, write_result

GRID = VoxelGrid((0, 0, 0), 0.5, (9, 8, 7))
VOXELS = np.array([[0, 0, 0], [8, 7, 6], [3, 4, 5]], np.int32)
PREVIEW = np.zeros((4, 4, 3), np.uint8)


def written(folder, layers, pictures=None):
    occupancy = np.zeros(GRID.shape, bool)
    occupancy[2:5, 2:5, 2:5] = True
    volume = SparseVolume.from_dense(GRID, occupancy)
    write_result(folder, volume=volume, surface=extract_surface(volume), colors=None, report={}, preview=PREVIEW, layers=layers,
                 pictures=pictures)
    return folder


@pytest.mark.parametrize("values", [np.array([0, 1, 255]), np.array([0, 70_000, 3]), np.array([-4, 0, 9]), np.array([True, False, True]),
                                    np.array([0.25, -1.5, 1e9])], ids=str)
def test_values_come_back_as_they_were(tmp_path, values):
    found = read_result(written(tmp_path / "result", {"carved": VoxelLayer(VOXELS, {"by": values})})).layers["carved"]
    np.testing.assert_array_equal(found.voxels, VOXELS)
    np.testing.assert_array_equal(found.values["by"], values)
    assert found.values["by"].dtype.kind in values.dtype.kind + "u"


def test_pictures_lie_in_a_folder_of_their_own(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (5, 6, 3)).astype(np.uint8)
    folder = written(tmp_path / "result", {}, {"light-1": picture})
    np.testing.assert_array_equal(cv2.imread(str(folder / "pictures" / "light-1.png"))[..., ::-1], picture)


def test_a_result_without_layers_has_none(tmp_path):
    folder = written(tmp_path / "result", {})
    report = json.loads((folder / REPORT).read_text())
    del report["layers"]  # as older results have it
    (folder / REPORT).write_text(json.dumps(report))
    assert read_result(folder).layers == {} and not (folder / "pictures").exists()


@pytest.mark.parametrize("layers, words", [
    (["carved"], "layers must be an object"), ({"../x": {}}, "layers must be an object"), ({"carved": 3}, "layers.carved must be an object"),
    ({"carved": {"by": "O"}}, "layers.carved.by: 'O'"), ({"carved": {"by": "<f4"}}, "carved_by is uint8"), ({"other": {}}, "no array other_voxels"),
])
def test_a_damaged_list_of_layers_is_refused_in_one_sentence(tmp_path, layers, words):
    folder = written(tmp_path / "result", {"carved": VoxelLayer(VOXELS, {"by": np.array([1, 2, 3])})})
    report = json.loads((folder / REPORT).read_text())
    (folder / REPORT).write_text(json.dumps({**report, "layers": layers}))
    with pytest.raises(ScanstageError, match=words.replace(".", r"\.")):
        read_result(folder)


def test_voxels_beyond_the_grid_are_refused(tmp_path):
    folder = written(tmp_path / "result", {"carved": VoxelLayer(VOXELS + [0, 0, 3], {})})
    with pytest.raises(ScanstageError, match="beyond the grid"):
        read_result(folder)


def test_a_layer_needs_one_value_a_voxel():
    with pytest.raises(ValueError, match="one value for each of the 3 voxels"):
        VoxelLayer(VOXELS, {"by": np.zeros(2)})
    with pytest.raises(ValueError, match=r"\(n, 3\)"):
        VoxelLayer(np.zeros((3, 2), np.int32), {})
