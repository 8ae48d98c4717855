# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Result folders: round trips, what numpy itself reads in them, bounded memory, and folders that lie."""

import io
import json
import tracemalloc
import zipfile

import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.color import linear_to_srgb
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.points import PointCloud
from addon.reconstruction.volumetric.coloring import SurfaceColors
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import EMPTY, SparseVolume
from addon.results.folder import check_replaceable, read_result, report_section, write_result
from addon.results.npz import open_volume, write_volume
from addon.results.ply import read_ply

PREVIEW = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)


@pytest.fixture
def parts():
    """Return what a method leaves: unequal sides, none a whole number of bricks, voxels at the grid's border."""
    grid = VoxelGrid((0.1, -0.2, 0.3), 0.05, (19, 10, 13))
    volume = SparseVolume.from_dense(grid, np.random.default_rng(5).random(grid.shape) < 0.2)
    surface = extract_surface(volume)
    rng = np.random.default_rng(6)
    colors = SurfaceColors(rng.random((len(surface.voxels), 3)).astype(np.float32),
                           rng.integers(0, 24, len(surface.voxels)).astype(np.uint16))
    report = {"method": "visual-hull", "options": {"a": np.float32(0.5)}, "counts": {"views": np.int64(24)},
              "seconds": {"carve": 1.5}, "warnings": []}
    return {"volume": volume, "surface": surface, "colors": colors, "report": report, "preview": PREVIEW}


@pytest.fixture
def folder(tmp_path, parts):
    write_result(tmp_path / "out" / "hull", **parts)
    return tmp_path / "out" / "hull"


def test_a_result_comes_back_as_it_went(folder, parts):
    result = read_result(folder)
    np.testing.assert_array_equal(result.volume.dense(), parts["volume"].dense())
    np.testing.assert_array_equal(result.surface.quads, parts["surface"].quads)
    np.testing.assert_array_equal(result.colors.rgb, parts["colors"].rgb)
    np.testing.assert_array_equal(result.colors.views, parts["colors"].views)
    assert result.report["options"] == {"a": 0.5} and result.report["counts"] == {"views": 24}
    assert result.report["grid"] == {"origin": [0.1, -0.2, 0.3], "voxel_size": 0.05, "shape": [19, 10, 13]}
    assert (result.report["format"], result.report["version"]) == ("scanstage-result", 1)
    np.testing.assert_array_equal(cv2.imread(str(folder / "preview.png"))[..., ::-1], PREVIEW)
    assert sorted(path.name for path in folder.parent.iterdir()) == ["hull"]


def test_a_result_of_a_method_that_measures_points_keeps_them(tmp_path, parts):
    cloud = PointCloud(np.eye(3), np.eye(3), np.zeros((3, 3)), np.full(3, 0.25), np.arange(3))
    write_result(tmp_path / "out", **parts, points=cloud)
    assert (tmp_path / "out" / "points.ply").is_file()
    np.testing.assert_array_equal(read_result(tmp_path / "out").points.positions, np.eye(3))
    write_result(tmp_path / "out", **parts)
    assert read_result(tmp_path / "out").points is None


def test_numpy_reads_the_volume_without_pickle(folder, parts):
    with np.load(folder / "volume.npz", allow_pickle=False) as file:
        assert file["occupancy"].dtype == bool
        np.testing.assert_array_equal(file["occupancy"], parts["volume"].dense())
        np.testing.assert_array_equal(file["origin"], (0.1, -0.2, 0.3))
        assert float(file["voxel_size"]) == 0.05
        assert file["surface_voxels"].dtype == np.int32 and file["surface_views"].dtype == np.uint16
        np.testing.assert_array_equal(file["surface_colors"], parts["colors"].rgb)


def test_what_numpy_writes_is_read(folder, parts):
    with np.load(folder / "volume.npz") as file:
        arrays = dict(file)
    order = np.random.default_rng(0).permutation(len(arrays["surface_voxels"]))  # any order of rows will do
    for name in ("surface_voxels", "surface_colors", "surface_views"):
        arrays[name] = arrays[name][order]
    np.savez_compressed(folder / "volume.npz", **arrays)
    result = read_result(folder)
    np.testing.assert_array_equal(result.volume.dense(), parts["volume"].dense())
    np.testing.assert_array_equal(result.colors.rgb, parts["colors"].rgb)


def test_a_result_without_colours_has_none(tmp_path, parts):
    write_result(tmp_path / "r", **{**parts, "colors": None})
    assert read_result(tmp_path / "r").colors is None


def test_an_empty_result_is_a_result(tmp_path, parts):
    volume = SparseVolume.from_dense(parts["volume"].grid, np.zeros(parts["volume"].grid.shape, bool))
    surface = extract_surface(volume)
    colors = SurfaceColors(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
    write_result(tmp_path / "r", **{**parts, "volume": volume, "surface": surface, "colors": colors})
    assert read_result(tmp_path / "r").volume.count() == 0


def test_the_mesh_encloses_the_volume_and_has_its_colours(tmp_path, parts):
    gray = SurfaceColors(np.full_like(parts["colors"].rgb, 0.5), parts["colors"].views)
    write_result(tmp_path / "r", **{**parts, "colors": gray})
    mesh = read_ply(tmp_path / "r" / "mesh.ply")
    # Coordinates are single precision: 1e-7 of 1 m, over voxels of 0.05 m.
    assert mesh.volume() == pytest.approx(parts["volume"].volume(), rel=1e-5)
    assert mesh.is_watertight()
    header, data = (tmp_path / "r" / "mesh.ply").read_bytes().split(b"end_header\n", 1)
    vertex = np.frombuffer(data, [("xyz", "<f4", 3), ("rgb", "u1", 3)], count=len(mesh.vertices))
    assert b"element face %d\n" % len(parts["surface"].quads) in header  # quads, not triangles
    np.testing.assert_array_equal(np.unique(vertex["rgb"]), round(float(linear_to_srgb(np.array(0.5))) * 255))


def test_an_older_result_is_replaced(folder, parts):
    write_result(folder, **{**parts, "report": {"method": "space-carving"}})
    assert read_result(folder).report["method"] == "space-carving"
    assert [path.name for path in folder.parent.iterdir()] == ["hull"]


def test_an_empty_folder_is_filled(tmp_path, parts):
    (tmp_path / "r").mkdir()
    write_result(tmp_path / "r", **parts)
    assert read_result(tmp_path / "r").report["method"] == "visual-hull"


@pytest.mark.parametrize("content", ["thesis.txt", "result.json"])
def test_anything_else_is_left_alone(tmp_path, parts, content):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / content).write_text('{"score": 3}')
    for function in (check_replaceable, lambda folder: write_result(folder, **parts)):
        with pytest.raises(ScanstageError, match="mine: is not empty and not a result"):
            function(tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == [content]
    with pytest.raises(ScanstageError, match="is a file"):
        check_replaceable(tmp_path / "mine" / content)


@pytest.mark.parametrize("wrong", [
    {"preview": PREVIEW.astype(float)}, {"report": {"nan": float("nan")}}, {"report": {"object": object()}},
    {"colors": SurfaceColors(np.zeros((1, 3), np.float32), np.zeros(1, np.uint16))},
])
def test_a_failed_write_leaves_the_old_result(folder, parts, wrong):
    with pytest.raises(ValueError):
        write_result(folder, **{**parts, **wrong})
    assert read_result(folder).report["method"] == "visual-hull"
    assert [path.name for path in folder.parent.iterdir()] == ["hull"]


def test_an_interrupted_write_leaves_nothing(tmp_path, parts, monkeypatch):
    def full(*_args, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("addon.results.folder.write_ply", full)
    with pytest.raises(ScanstageError, match="No space left"):
        write_result(tmp_path / "r", **parts)
    assert not list(tmp_path.iterdir())


def test_a_section_is_added_and_replaced(folder):
    for value in (1.0, 2.0):
        report_section(folder, "evaluation", {"volume": {"iou": np.float64(value)}})
    report = read_result(folder).report
    assert report["evaluation"] == {"volume": {"iou": 2.0}} and report["method"] == "visual-hull"
    with pytest.raises(ValueError, match="grid belongs to the format"):
        report_section(folder, "grid", {})
    with pytest.raises(ScanstageError, match="name the folder of a result"):
        report_section(folder.parent, "evaluation", {})


def replace_array(folder, name: str, array: np.ndarray) -> None:
    with np.load(folder / "volume.npz") as file:
        arrays = {**file, name: array}
    np.savez_compressed(folder / "volume.npz", **arrays)


def replace_entry(folder, name: str, data: bytes | None) -> None:
    with zipfile.ZipFile(folder / "volume.npz") as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    with zipfile.ZipFile(folder / "volume.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, content in {**entries, f"{name}.npy": data}.items():
            if content is not None:
                archive.writestr(entry, content)


def npy(shape: tuple[int, ...], descr: str, data: bytes, order: bool = False) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": order, "shape": shape})
    return file.getvalue() + data


@pytest.mark.parametrize(("name", "data", "problem"), [
    ("occupancy", None, "has no array occupancy"),
    ("occupancy", b"", "is no numpy array|ends early"),
    ("occupancy", npy((19, 10, 13), "|b1", bytes(2469)), "occupancy has .* bytes"),
    ("occupancy", npy((19, 10, 13), "|b1", bytes(9999)), "occupancy has .* bytes"),
    ("occupancy", npy((19, 10, 14), "|b1", bytes(2660)), "occupancy is bool"),
    ("occupancy", npy((10 ** 9, 10 ** 9, 10 ** 9), "|b1", b""), "occupancy is bool"),
    ("occupancy", npy((19, 10, 13), "<f8", bytes(19760)), "occupancy is float64"),
    ("occupancy", npy((19, 10, 13), "|b1", bytes(2470), order=True), "occupancy is bool"),
    ("occupancy", npy((19, 10, 13), "|b1", b"\x02" * 2470), "other than 0 and 1"),
    ("occupancy", b"\x93NUMPY\x01\x00\x10\x00" + b"(" * 16, "is no numpy array"),
    ("occupancy", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, "is no numpy array"),
    ("surface_voxels", npy((10 ** 12, 3), "<i4", b""), "rows|bytes"),
    ("surface_colors", npy((2, 3), "<f4", bytes(24)), "surface_colors is float32"),
    ("surface_views", None, "has no array surface_views"),
])
def test_an_archive_that_lies_is_one_sentence(folder, name, data, problem):
    replace_entry(folder, name, data)
    with pytest.raises(ScanstageError, match=problem) as error:
        read_result(folder)
    assert "volume.npz" in str(error.value) and "\n" not in str(error.value)


def test_objects_are_never_unpickled(folder):
    file = io.BytesIO()
    np.lib.format.write_array(file, np.array([{}, []], object), allow_pickle=True)
    replace_entry(folder, "origin", file.getvalue())
    with pytest.raises(ScanstageError, match="origin is object"):
        read_result(folder)


@pytest.mark.parametrize(("name", "change", "problem"), [
    ("surface_voxels", lambda a: a + 100, "not the surface"),
    ("surface_voxels", lambda a: a[:-1], "not the surface"),
    ("surface_colors", lambda a: a * np.float32(np.nan), "not finite"),
    ("origin", lambda a: a + 1, "origin and voxel_size"),
])
def test_arrays_that_disagree_are_refused(folder, name, change, problem):
    with np.load(folder / "volume.npz") as file:
        array = file[name]
    replace_array(folder, name, change(array))
    with pytest.raises(ScanstageError, match=problem):
        read_result(folder)


def test_truncated_archives_are_refused(folder):
    data = (folder / "volume.npz").read_bytes()
    for length in range(0, len(data), max(1, len(data) // 25)):
        (folder / "volume.npz").write_bytes(data[:length])
        with pytest.raises(ScanstageError, match="volume.npz"):
            read_result(folder)


def test_damaged_archives_are_refused_or_read(folder):
    data, rng, refused = (folder / "volume.npz").read_bytes(), np.random.default_rng(1), 0
    for _ in range(40):
        noisy = bytearray(data)
        noisy[rng.integers(len(data))] ^= int(rng.integers(1, 256))
        (folder / "volume.npz").write_bytes(noisy)
        try:
            read_result(folder)
        except ScanstageError:
            refused += 1
    assert refused > 20  # nearly every byte is covered by a checksum


@pytest.mark.parametrize(("change", "problem"), [
    ({"version": 2}, "version is 2"), ({"format": "other"}, "format is not"), ({"grid": None}, "grid:"),
    ({"grid": {"origin": [0, 0, 0], "shape": [1, 1, 1]}}, "grid.voxel_size is missing"),
    ({"grid": {"origin": [0, 0, 0], "voxel_size": -1, "shape": [1, 1, 1]}}, "voxel_size must be positive"),
    ({"grid": {"origin": [0, 0, "a"], "voxel_size": 1, "shape": [1, 1, 1]}}, "grid:"),
    ({"grid": {"origin": [0, 0, 0], "voxel_size": 1, "shape": [1, 1, 1.5]}}, "three whole numbers"),
    ({"grid": {"origin": [0.1, -0.2, 0.3], "voxel_size": 0.05, "shape": [10 ** 6] * 3}}, "more than 16384 a side"),
])
def test_a_report_that_lies_is_one_sentence(folder, change, problem):
    report = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps({**report, **change}))
    with pytest.raises(ScanstageError, match=problem) as error:
        read_result(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "[" * 100_000, "[1, 2]", '{"format": ', "\xff", "1" * 5000])
def test_what_is_not_a_report_is_refused(folder, text):
    (folder / "result.json").write_text(text, encoding="latin-1")
    with pytest.raises(ScanstageError, match="result.json"):
        read_result(folder)


def test_a_wide_grid_never_lies_dense_in_memory(tmp_path):
    """1024 x 1024 x 160 voxels are 160 MiB dense; a slab of them is 1.25 MiB."""
    grid = VoxelGrid((0, 0, 0), 0.001, (1024, 1024, 160))
    brick_map = np.full((128, 128, 20), EMPTY, np.int32)
    brick_map[30:90, 40:100, 10] = np.arange(3600).reshape(60, 60)
    volume = SparseVolume(grid, brick_map, np.random.default_rng(0).random((3600, 8, 8, 8)) < 0.5)
    tracemalloc.start()
    try:
        write_volume(tmp_path / "volume.npz", volume, {})
        with open_volume(tmp_path / "volume.npz") as file:
            back = file.volume(grid)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(back.brick_map == EMPTY, brick_map == EMPTY)
    np.testing.assert_array_equal(back.bricks, volume.bricks)
    assert peak < 48 << 20
