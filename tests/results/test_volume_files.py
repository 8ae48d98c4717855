# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that go out and come in as one file: the same voxels, colours and places, by each format's own rules."""

import struct

import numpy as np
import pytest

from addon import compat
from addon.cli import main
from addon.errors import ScanstageError
from addon.reconstruction.color import srgb_to_linear
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric.cavities import without_cavities
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.export import export_mesh, export_result
from addon.results.point_file import read_points
from addon.results.volume_files import read_volume
from addon.results.vox_reader import default_palette, read_vox

pytestmark = pytest.mark.usefixtures("empty_scene")


def blob(shape=(21, 13, 18), seed=2):
    """Return an irregular solid without cavities that touches every side of its grid."""
    grid = VoxelGrid((0.3, -0.7, 0.1), 0.25, shape)
    places = np.indices(shape).reshape(3, -1).T / (np.array(shape) - 1) * 2 - 1
    bumps = np.random.default_rng(seed).normal(size=(3, 3)) * 2
    solid = ((places ** 2).sum(-1) < 0.8 + 0.2 * np.sin(places @ bumps).prod(-1)) | (np.abs(places) < 0.2).sum(-1) >= 2
    return without_cavities(SparseVolume.from_dense(grid, solid.reshape(shape)))


def shaded(surface):
    """Return colours (s, 3) that are whole bytes of sRGB, fewer than 255 of them, and not symmetrical."""
    return srgb_to_linear(np.column_stack((surface.voxels[:, 0] % 6 * 40, surface.voxels[:, 1] % 5 * 50, surface.voxels[:, 2] % 7 * 30)) / 255)


def reachable(solid):
    """Return by brute force, one voxel at a time, which empty voxels a way through faces leads to from outside."""
    empty = np.pad(~solid, 1, constant_values=True)
    seen = np.zeros_like(empty)
    waiting = [(0, 0, 0)]
    while waiting:
        place = waiting.pop()
        if all(0 <= p < n for p, n in zip(place, empty.shape, strict=True)) and empty[place] and not seen[place]:
            seen[place] = True
            waiting += [tuple(np.add(place, step)) for step in np.concatenate((np.eye(3, dtype=int), -np.eye(3, dtype=int)))]
    return seen[1:-1, 1:-1, 1:-1]


@pytest.mark.parametrize("share", [0.3, 0.5, 0.62, 0.75])
def test_cavities_are_what_no_way_through_faces_leads_to(share):
    solid = np.random.default_rng(int(share * 100)).random((19, 9, 11)) < share
    filled = without_cavities(SparseVolume.from_dense(VoxelGrid((0, 0, 0), 1, solid.shape), solid)).dense()
    np.testing.assert_array_equal(filled, ~reachable(solid))


@pytest.mark.parametrize("shape", [(21, 13, 18), (300, 5, 9)])
def test_a_vox_file_comes_back_solid_with_its_colours(tmp_path, shape):
    volume = blob(shape)
    surface = extract_surface(volume)
    export_mesh(surface, shaded(surface), tmp_path / "a.vox", grid=volume.grid)
    found = read_volume(tmp_path / "a.vox", voxel_size=0.25)
    np.testing.assert_array_equal(found.volume.dense(), volume.dense())
    np.testing.assert_array_equal(found.surface.voxels, surface.voxels)
    np.testing.assert_allclose(found.colors.rgb, shaded(surface), atol=1e-6)
    np.testing.assert_allclose(found.volume.grid.origin, np.array([-(shape[0] // 2), -(shape[1] // 2), 0]) * 0.25)


@pytest.mark.parametrize("colored", [True, False])
def test_an_npz_comes_back_as_it_went(tmp_path, colored):
    volume = blob()
    surface = extract_surface(volume)
    export_mesh(surface, shaded(surface) if colored else None, tmp_path / "a.npz", grid=volume.grid, volume=volume)
    found = read_volume(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.volume.dense(), volume.dense())
    assert found.volume.grid.voxel_size == 0.25 and (found.volume.grid.origin == volume.grid.origin).all()
    assert (found.colors is not None) == colored
    if colored:
        np.testing.assert_allclose(found.colors.rgb, shaded(surface), atol=1e-6)


def test_numpys_own_archive_needs_no_more_than_the_occupancy(tmp_path):
    solid = blob().dense()
    np.savez_compressed(tmp_path / "a.npz", occupancy=solid)
    found = read_volume(tmp_path / "a.npz", voxel_size=0.5)
    np.testing.assert_array_equal(found.volume.dense(), solid)
    assert found.volume.grid.voxel_size == 0.5 and not found.volume.grid.origin.any() and found.colors is None


def test_goxels_text_is_a_line_a_voxel(tmp_path, corner, grid):
    export_mesh(corner, np.array([(1, 0, 0), (0, 1, 0), (0, 0.2158605, 1)]), tmp_path / "a.txt", grid=grid)
    lines = [line for line in (tmp_path / "a.txt").read_text().splitlines() if not line.startswith("#")]
    assert sorted(lines) == sorted(f"{x} {y} {z} {color}" for (x, y, z), color in zip(corner.voxels, ("ff0000", "00ff00", "0080ff"), strict=True))


def test_openvdb_has_the_axes_the_place_and_the_colours(tmp_path, grid):
    vdb = compat.openvdb()
    if vdb is None:
        pytest.skip("this Blender has no module openvdb")
    solid = np.random.default_rng(4).random((19, 3, 5)) < 0.4
    grid = VoxelGrid(grid.origin, grid.voxel_size, solid.shape)
    volume = SparseVolume.from_dense(grid, solid)
    surface = extract_surface(volume)
    export_mesh(surface, shaded(surface), tmp_path / "a.vdb", grid=grid, volume=volume)
    grids, _ = vdb.readAll(str(tmp_path / "a.vdb"))
    density, color = sorted(grids, key=lambda part: part.name)[::-1]
    assert (density.name, color.name) == ("density", "color")
    back, shades = np.zeros(solid.shape, np.float32), np.zeros((*solid.shape, 3), np.float32)
    density.copyToArray(back)
    color.copyToArray(shades)
    np.testing.assert_array_equal(back, solid)
    assert density.activeVoxelCount() == np.count_nonzero(solid)
    np.testing.assert_allclose(shades[tuple(surface.voxels.T)], shaded(surface), atol=1e-6)
    for voxel in ((0, 0, 0), (18, 1, 4)):
        for part in grids:
            np.testing.assert_allclose(part.transform.indexToWorld(voxel), grid.centres(voxel), atol=1e-12)


def test_points_are_the_centres_of_the_surfaces_voxels(tmp_path):
    volume = blob()
    surface = extract_surface(volume)
    export_mesh(surface, shaded(surface), tmp_path / "a.npz", grid=volume.grid, volume=volume)
    assert export_result(tmp_path / "a.npz", tmp_path / "a.ply", {"points": True}) == len(surface.voxels)
    cloud = read_points(tmp_path / "a.ply")
    np.testing.assert_allclose(cloud.positions, volume.grid.centres(surface.voxels), atol=1e-6)
    np.testing.assert_allclose(cloud.colors, shaded(surface), atol=1e-6)
    with pytest.raises(ScanstageError, match="a.obj: points are written as .ply only"):
        export_result(tmp_path / "a.npz", tmp_path / "a.obj", {"points": True})


# Files by other hands


def chunk(name, content=b"", children=b""):
    return name + struct.pack("<2i", len(content), len(children)) + content + children


def words(**entries):
    texts = [word.encode() for entry in entries.items() for word in entry]
    return struct.pack("<i", len(entries)) + b"".join(struct.pack("<i", len(text)) + text for text in texts)


def model(size, voxels):
    return chunk(b"SIZE", struct.pack("<3i", *size)) + chunk(b"XYZI", struct.pack("<i", len(voxels)) + bytes(np.array(voxels, np.uint8)))


def transform(id, child, frame=b"\0\0\0\0", **attributes):
    return chunk(b"nTRN", struct.pack("<i", id) + words(**attributes) + struct.pack("<4i", child, -1, 0, 1) + frame)


def group(id, *children):
    return chunk(b"nGRP", struct.pack("<i", id) + words() + struct.pack(f"<{1 + len(children)}i", len(children), *children))


def shape(id, model):
    return chunk(b"nSHP", struct.pack("<i", id) + words() + struct.pack("<2i", 1, model) + words())


def vox(*chunks):
    return b"VOX " + struct.pack("<i", 150) + chunk(b"MAIN", b"", b"".join(chunks))


LINE = model((3, 1, 1), [(0, 0, 0, 1), (1, 0, 0, 2), (2, 0, 0, 6)])


def test_a_bare_model_has_the_default_palette(tmp_path):
    (tmp_path / "a.vox").write_bytes(vox(LINE))
    voxels, rgb = read_vox(tmp_path / "a.vox")
    assert voxels.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert rgb[0].tolist() == [1, 1, 1] and rgb[2].tolist() == [1, 1, 0]
    palette = default_palette()  # of MagicaVoxel's own description: number 1 first
    assert palette.shape == (255, 3)
    assert [bytes(palette[n - 1]).hex() for n in (1, 2, 7, 37, 215, 216, 225, 226, 236, 246, 255)] == [
        "ffffff", "ffffcc", "ffccff", "ccffff", "000033", "ee0000", "110000", "00ee00", "0000ee", "eeeeee", "111111"]


@pytest.mark.parametrize(("turn", "expected"), [
    ("4", [[4, 0, 0], [5, 0, 0], [6, 0, 0]]),  # as it is: its middle voxel, number 1, stands at 5
    (str(1 | 0 << 2 | 1 << 4), [[4, -1, 0], [4, 0, 0], [4, 1, 0]]),  # x' = -y, y' = x: a quarter turn about z
    (str(0 | 1 << 2 | 1 << 4 | 1 << 5), [[3, -1, 0], [4, -1, 0], [5, -1, 0]]),  # half a turn about z
])
def test_rotations_are_those_of_the_scene_graph(tmp_path, turn, expected):
    graph = transform(0, 1) + group(1, 2) + transform(2, 3, words(_r=turn, _t="5 0 0")) + shape(3, 0)
    (tmp_path / "a.vox").write_bytes(vox(LINE, graph))
    voxels, rgb = read_vox(tmp_path / "a.vox")
    # The centre (p + 1/2) of each voxel about the pivot at the model's middle voxel's corner, turned as real numbers.
    bits = int(turn)
    matrix = np.zeros((3, 3))
    for row, column in enumerate((bits & 3, bits >> 2 & 3, 3 - (bits & 3) - (bits >> 2 & 3))):
        matrix[row, column] = -1 if bits >> (4 + row) & 1 else 1
    centres = (np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0)]) + 0.5 - (1, 0, 0)) @ matrix.T + (5, 0, 0)
    assert sorted(np.floor(centres).astype(int).tolist()) == sorted(voxels.tolist()) == sorted(expected)
    assert abs(np.linalg.det(matrix) - 1) < 1e-12


def test_hidden_nodes_are_left_out_and_the_later_of_two_models_is_seen(tmp_path):
    other = model((1, 1, 1), [(0, 0, 0, 1)])
    graph = transform(0, 1) + group(1, 2, 4, 6) + transform(2, 3) + shape(3, 0) + transform(4, 5) + shape(5, 1) \
        + transform(6, 7, words(_t="40 0 0"), _hidden="1") + shape(7, 0)
    (tmp_path / "a.vox").write_bytes(vox(LINE, other, graph))
    voxels, rgb = read_vox(tmp_path / "a.vox")
    assert voxels.tolist() == [[-1, 0, 0], [0, 0, 0], [1, 0, 0]] and rgb[1].tolist() == [1, 1, 1]


LOOPS = [transform(i, i + 1) for i in range(0, 200, 2)] + [group(i, i + 1, i + 1) for i in range(1, 200, 2)]
BAD = {
    "empty": (b"", "does not begin"), "cut": (vox(LINE)[:-3], "no whole MAIN"), "nothing": (vox(), "shows no voxels"),
    "longer": (b"VOX " + struct.pack("<i", 150) + chunk(b"MAIN", b"", b"SIZE" + struct.pack("<2i", 10 ** 6, 0)), "longer than the file"),
    "size": (vox(model((10 ** 9, 1, 1), [])), "size is 1000000000"), "no size": (vox(chunk(b"XYZI", struct.pack("<i", 0))), "has no size"),
    "outside": (vox(model((1, 1, 1), [(1, 0, 0, 1)])), "outside of its model"), "colourless": (vox(model((1, 1, 1), [(0, 0, 0, 0)])), "no colour"),
    "count": (vox(chunk(b"SIZE", struct.pack("<3i", 1, 1, 1)), chunk(b"XYZI", struct.pack("<i", 2 ** 30))), "not as long as that"),
    "palette": (vox(LINE, chunk(b"RGBA", bytes(40))), "palette is cut off"),
    "itself": (vox(LINE, transform(0, 0)), "leads back to itself"), "branches": (vox(LINE, *LOOPS, shape(200, 0)), "too many branches"),
    "missing": (vox(LINE, transform(0, 9)), "no node 9"), "model": (vox(LINE, transform(0, 1), shape(1, 7)), "shows model 7 of 1"),
    "turn": (vox(LINE, transform(0, 1, words(_r="0")), shape(1, 0)), "rotation '0' is none"),
    "place": (vox(LINE, transform(0, 1, words(_t="1 2")), shape(1, 0)), "translation '1 2' is none"),
    "far": (vox(LINE, transform(0, 1, words(_t="99999999 0 0")), shape(1, 0)), "is too large"),
    "words": (vox(LINE, chunk(b"nTRN", struct.pack("<2i", 0, 2 ** 30))), "attributes are longer"),
    "children": (vox(LINE, transform(0, 1), chunk(b"nGRP", struct.pack("<3i", 1, 0, 2 ** 30))), "counts 1073741824 entries"),
    "wide": (vox(LINE, transform(0, 1), group(1, 2, 4), transform(2, 3), shape(3, 0), transform(4, 5, words(_t="900000 0 0")), shape(5, 0)), "more than 16384 a side"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_vox_file_that_lies_is_one_sentence(tmp_path, case):
    data, problem = BAD[case]
    (tmp_path / "a.vox").write_bytes(data)
    with pytest.raises(ScanstageError, match=problem) as caught:
        read_volume(tmp_path / "a.vox")
    assert str(caught.value).startswith(f"{tmp_path / 'a.vox'}: ")


def test_the_verb_mesh_takes_volumes(tmp_path, capfd):
    volume = blob()
    surface = extract_surface(volume)
    export_mesh(surface, shaded(surface), tmp_path / "a.vox", grid=volume.grid)
    assert main(["mesh", str(tmp_path / "a.vox"), "--out", str(tmp_path / "a.glb"), "--set", "voxel_size=0.01", "--quiet"]) == 0
    assert (tmp_path / "a.glb").read_bytes()[:4] == b"glTF"
    assert main(["mesh", str(tmp_path / "a.glb"), "--out", str(tmp_path / "b.ply"), "--quiet"]) == 1
    assert "is neither a result's folder nor a volume; give a folder, or a file that ends in .npz or .vox" in capfd.readouterr().err
    with pytest.raises(ScanstageError, match="voxel_size must be positive"):
        np.savez(tmp_path / "b.npz", occupancy=np.ones((2, 2, 2), bool), voxel_size=np.float64(-1))
        read_volume(tmp_path / "b.npz")
