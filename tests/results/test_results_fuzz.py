# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Results, volumes and meshes of small size with something broken in them: each is read, or refused in one sentence."""

import copy
import io
import json
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon.errors import ScanstageError
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.mesh import TriangleMesh
from addon.reconstruction.outcome import VoxelLayer
from addon.reconstruction.volumetric.coloring import SurfaceColors
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.folder import Result, read_result, write_result
from addon.results.ply import read_ply, write_ply
from addon.results.point_file import read_points, surface_points, write_points
from addon.results.volume_files import read_volume
from addon.results.vox import write_vox

SOLID = np.random.default_rng(8).random((11, 4, 5)) < 0.5
VOLUME = SparseVolume.from_dense(VoxelGrid((0.1, 0.2, 0.3), 0.5, SOLID.shape), SOLID)
SURFACE = extract_surface(VOLUME)
COLORS = SurfaceColors(np.full((len(SURFACE.voxels), 3), 0.5, np.float32), np.ones(len(SURFACE.voxels), np.uint16))
LAYERS = {"carved": VoxelLayer(np.array([(0, 0, 0), (1, 2, 3)]), {"view": np.array([1, 2]), "share": np.array([0.5, 0.25])})}
fuzzed = settings(max_examples=150, deadline=2000, derandomize=True,
                  suppress_health_check=[HealthCheck.function_scoped_fixture])

JUNK = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6) | st.sampled_from(
    [-1, 0, 1, 2 ** 31, 2 ** 63, 10 ** 30, 1e308, "..", "/etc/passwd", "|O", "<f4", "triangles"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3), max_leaves=5)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the folder of a result with colours, layers, a mesh of its own and points."""
    folder = tmp_path_factory.mktemp("made") / "result"
    mesh = TriangleMesh(np.eye(3), np.array([(0, 1, 2)]))
    write_result(folder, volume=VOLUME, surface=SURFACE, colors=COLORS, report={"method": "visual-hull", "counts": {"occupied": 1}},
                 preview=np.zeros((2, 2, 3), np.uint8), layers=LAYERS, mesh=mesh, points=surface_points(SURFACE, VOLUME.grid, COLORS.rgb))
    return folder


def read_or_refused(read, path):
    try:
        return read(path)
    except ScanstageError as error:
        assert str(error).isprintable() and len(str(error)) < 600
        return None


def places(value, path=()):
    yield path
    for key, child in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(child, (*path, key))


@fuzzed
@given(st.data())
def test_a_changed_report_is_read_or_refused(made, data):
    path = made / "result.json"
    text = path.read_text()
    document = {"top": copy.deepcopy(json.loads(text))}
    for _ in range(data.draw(st.integers(1, 3))):
        *parents, last = data.draw(st.sampled_from([place for place in places(document) if place]))
        owner = document
        for step in parents:
            owner = owner[step]
        owner[last] = data.draw(JUNK)
    try:
        path.write_text(json.dumps(document["top"]))
        found = read_or_refused(read_result, made)
        assert found is None or isinstance(found, Result)
    finally:
        path.write_text(text)


@st.composite
def damaged(draw, data, header=None):
    """Return bytes after a few of them, of the first ``header``, were changed, cut out or doubled."""
    data = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(min(len(data), header or len(data)) - 1, 0)))
        kind = draw(st.sampled_from(["byte", "word", "cut", "double", "text"]))
        if kind == "byte" and data:
            data[at] = draw(st.integers(0, 255))
        elif kind == "word":
            data[at:at + 4] = struct.pack("<i", draw(st.sampled_from([-1, 0, 1, 2 ** 30, 2 ** 31 - 1, -2 ** 31, 256])))
        elif kind == "cut":
            del data[at:at + draw(st.integers(1, 20))]
        elif kind == "double":
            data[at:at] = data[at:at + 16]
        else:
            data[at:at] = draw(st.sampled_from([b"nan", b"-1", b"9" * 40, b"\n", b" ", b"1e999", b"(" * 50]))
    return bytes(data)


@fuzzed
@given(st.data())
def test_a_damaged_array_of_an_archive_is_read_or_refused(made, tmp_path, data):
    with zipfile.ZipFile(made / "volume.npz") as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    chosen = data.draw(st.sampled_from(sorted(entries)))
    entries[chosen] = data.draw(damaged(entries[chosen], header=140))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:  # right checksums, so that the damage is read
        for name, content in entries.items():
            archive.writestr(name, content)
    read_or_refused(read_volume, tmp_path / "a.npz")


@fuzzed
@given(st.data())
def test_a_damaged_vox_is_read_or_refused(tmp_path, data):
    if not (tmp_path / "whole.vox").exists():
        write_vox(tmp_path / "whole.vox", np.concatenate((SURFACE.voxels, [(300, 0, 0)])), np.full((len(SURFACE.voxels) + 1, 3), 0.3))
    (tmp_path / "a.vox").write_bytes(data.draw(damaged((tmp_path / "whole.vox").read_bytes())))
    read_or_refused(read_volume, tmp_path / "a.vox")


@fuzzed
@given(st.data())
def test_a_damaged_ply_is_read_or_refused(tmp_path, data):
    write_ply(tmp_path / "a.ply", SURFACE.vertices, SURFACE.quads, vertex_colors=np.zeros((len(SURFACE.vertices), 3), np.uint8))
    (tmp_path / "a.ply").write_bytes(data.draw(damaged((tmp_path / "a.ply").read_bytes(), header=400)))
    read_or_refused(read_ply, tmp_path / "a.ply")
    write_points(tmp_path / "b.ply", surface_points(SURFACE, VOLUME.grid, COLORS.rgb))
    (tmp_path / "b.ply").write_bytes(data.draw(damaged((tmp_path / "b.ply").read_bytes(), header=500)))
    read_or_refused(read_points, tmp_path / "b.ply")


# What such searches found, and what would take all memory


@pytest.mark.parametrize("layers", [{"carved": {"view": []}}, {"carved": {"view": {"a": 1}}}, {"carved": {"view": None}}])
def test_a_layers_type_that_is_no_text_is_refused(made, layers):
    path = made / "result.json"
    text = path.read_text()
    try:
        path.write_text(json.dumps({**json.loads(text), "layers": layers}))
        with pytest.raises(ScanstageError, match="layers.carved.view: .* is none of"):
            read_result(made)
    finally:
        path.write_text(text)


@pytest.mark.parametrize("name", ["surface_voxels", "carved_voxels"])
def test_an_archive_that_swells_is_refused_before_it_is_read(made, tmp_path, name):
    """Rows of zeros are a thousandth of their size in an archive."""
    rows = 2_000_000
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<i4", "fortran_order": False, "shape": (rows, 3)})
    with zipfile.ZipFile(made / "volume.npz") as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    for item in made.iterdir():
        (tmp_path / item.name).write_bytes(item.read_bytes())
    with zipfile.ZipFile(tmp_path / "volume.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, content in {**entries, f"{name}.npy": header.getvalue()}.items():
            with archive.open(entry, "w") as file:
                file.write(content)
                if entry == f"{name}.npy":
                    file.write(bytes(12 * rows))
    with pytest.raises(ScanstageError, match=f"{name} has 2000000 rows, more than {SOLID.size}"):
        read_result(tmp_path)


@pytest.mark.parametrize("name", ["result.json", "volume.npz", "mesh.ply", "points.ply"])
def test_no_part_of_a_result_is_read_through_a_link_out_of_its_folder(made, tmp_path, name):
    (tmp_path / "result").mkdir()
    for item in made.iterdir():
        (tmp_path / "result" / item.name).write_bytes(item.read_bytes())
    (tmp_path / "result" / name).rename(tmp_path / name)
    (tmp_path / "result" / name).symlink_to(tmp_path / name)
    with pytest.raises(ScanstageError, match=f"{name}.* is a link out of the result"):
        read_result(tmp_path / "result")
