# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY files: round trips, every variant a third party writes, and files that lie."""

import struct

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.results.ply import read_ply, write_ply

VERTICES = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)], float)
PYRAMID = np.array([(3, 2, 1), (3, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)])


def file_of(header: str, body: bytes = b"") -> bytes:
    return ("ply\n" + header + "end_header\n").encode() + body


def mixed_faces(order: str) -> tuple[bytes, np.ndarray, np.ndarray]:
    """Return a file of polygons of 0 to 6 corners and properties of all kinds, its points and its fan triangles."""
    rng = np.random.default_rng(7)
    points, faces = rng.random((50, 3)), [rng.integers(0, 50, rng.integers(0, 7)).tolist() for _ in range(9000)]
    triangles = [(f[0], f[i], f[i + 1]) for f in faces for i in range(1, len(f) - 1)]
    header = (f"format {order} 1.0\ncomment end of line\nelement edge 2\nproperty list uint8 short ends\n"
              "element vertex 50\nproperty double x\nproperty uchar red\nproperty double y\nproperty double z\n"
              f"element face {len(faces)}\nproperty short flags\nproperty list ushort int vertex_index\n"
              "property list uchar float texcoord\nelement note 1\nproperty int n\n")
    if order == "ascii":
        rows = ["2 5 6", "0"] + [f"{x!r} 9 {y!r} {z!r}" for x, y, z in points.tolist()]
        rows += [" ".join(map(str, [-3, len(f), *f, 1, 0.25])) for f in faces]
        return file_of(header, "\n".join([*rows, "1", ""]).encode()), points, np.array(triangles)
    sign = "<" if "little" in order else ">"
    body = struct.pack(sign + "B2hB", 2, 5, 6, 0)
    body += b"".join(struct.pack(sign + "dBdd", x, 9, y, z) for x, y, z in points)
    body += b"".join(struct.pack(f"{sign}hH{len(f)}iBf", -3, len(f), *f, 1, 0.25) for f in faces)
    return file_of(header, body + struct.pack(sign + "i", 1)), points, np.array(triangles)


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_polygons_between_other_data_become_fans(tmp_path, order):
    data, points, triangles = mixed_faces(order)
    (tmp_path / "a.ply").write_bytes(data)
    mesh = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, points)
    np.testing.assert_array_equal(mesh.triangles, triangles)


@pytest.mark.parametrize("double", [False, True])
def test_triangles_come_back_as_they_went(tmp_path, double):
    vertices = np.random.default_rng(0).normal(size=(5, 3))
    write_ply(tmp_path / "a.ply", vertices, PYRAMID, double=double, normals=vertices, comments=["one\ntwo"],
              vertex_colors=np.full((5, 3), 7, np.uint8), face_colors=np.full((6, 3), 9, np.uint8))
    mesh = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, vertices if double else vertices.astype(np.float32))
    np.testing.assert_array_equal(mesh.triangles, PYRAMID)


def test_quads_come_back_as_two_triangles_each(tmp_path):
    write_ply(tmp_path / "a.ply", VERTICES, np.array([(0, 1, 2, 3), (3, 2, 1, 4)]))
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply").triangles, [(0, 1, 2), (0, 2, 3), (3, 2, 1), (3, 1, 4)])


def test_points_have_no_triangles(tmp_path):
    write_ply(tmp_path / "a.ply", VERTICES)
    mesh = read_ply(tmp_path / "a.ply")
    assert mesh.vertices.shape == (5, 3) and mesh.triangles.shape == (0, 3)
    write_ply(tmp_path / "empty.ply", VERTICES[:0], PYRAMID[:0])
    assert len(read_ply(tmp_path / "empty.ply").vertices) == 0


def test_every_truncation_is_refused(tmp_path):
    data, _, _ = mixed_faces("binary_little_endian")
    path = tmp_path / "cut.ply"
    for length in [*range(0, 500, 7), *range(len(data) - 60, len(data), 3)]:
        path.write_bytes(data[:length])
        with pytest.raises(ScanstageError, match="cut.ply"):
            read_ply(path)


XYZ = "property float x\nproperty float y\nproperty float z\n"
FACE = "property list uchar int vertex_indices\n"
ONE_FACE = "format ascii 1.0\nelement vertex 1\n" + XYZ + "element face 1\n"
BINARY_FACE = "format binary_little_endian 1.0\nelement vertex 0\n" + XYZ + "element face 1\n"


@pytest.mark.parametrize(("data", "problem"), [
    (b"solid cube\n", "first line"),
    (b"ply\nformat ascii 1.0\n", "does not end"),
    (file_of("element vertex 1\n" + XYZ), "does not state the format"),
    (file_of("format ascii 2.0\n"), "format ascii 2.0"),
    (file_of("format ascii 1.0\nelement vertex -1\n"), "element vertex -1"),
    (file_of("format ascii 1.0\nproperty float x\n"), "property float x"),
    (file_of("format ascii 1.0\nelement vertex 1\nproperty half x\n"), "property half x"),
    (file_of("format ascii 1.0\nelement vertex 1\nproperty list float int x\n"), "counts a list in fractions"),
    (file_of("format ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n", b"1 2\n"), "no property z"),
    (file_of("format ascii 1.0\nelement vertex 1\nproperty list uchar float x\n", b"1 2\n"), "a list named x"),
    (file_of("format ascii 1.0\n"), "no element named vertex"),
    (file_of("format ascii 1.0\nelement vertex 1\n" + XYZ, b"1 2 three\n"), "not a number"),
    (file_of("format ascii 1.0\nelement vertex 2\n" + XYZ, b"1 2 3 4 nan 6\n"), "vertex 1 is not finite"),
    (file_of(ONE_FACE + FACE, b"0 0 0 3 0 0 1\n"), "names a vertex"),
    (file_of(ONE_FACE + FACE, b"0 0 0 3 0 0 -1\n"), "names a vertex"),
    (file_of(ONE_FACE + FACE, b"0 0 0 3 0 nan 0\n"), "whole number"),
    (file_of(ONE_FACE + FACE, b"0 0 0 1e9 0 0 0\n"), "ends early"),
    (file_of(ONE_FACE + "property int vertex_indices\n", b"0 0 0 3"), "not a list"),
    (file_of("format binary_little_endian 1.0\nelement vertex 999999999999999\n" + XYZ, bytes(48)), "promises"),
    (file_of("format binary_little_endian 1.0\nelement nothing 999999999999999\n"), "promises"),
    (file_of(BINARY_FACE + "property list uint int vertex_indices\n", b"\xff\xff\xff\xff" + bytes(9)), "ends early"),
    (file_of(BINARY_FACE + "property list char int vertex_indices\n", b"\x80" + bytes(9)), "ends early"),
])
def test_a_file_that_lies_is_one_sentence(tmp_path, data, problem):
    path = tmp_path / "bad.ply"
    path.write_bytes(data)
    with pytest.raises(ScanstageError, match=problem) as error:
        read_ply(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_noise_is_refused_or_read_but_never_crashes(tmp_path):
    data, _, _ = mixed_faces("binary_big_endian")
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(60):
        noisy = np.frombuffer(data, np.uint8).copy()
        noisy[rng.integers(0, 2500, 3)] = rng.integers(0, 256, 3)
        (tmp_path / "noise.ply").write_bytes(noisy.tobytes())
        try:
            read_ply(tmp_path / "noise.ply")
        except ScanstageError:
            refused += 1
    assert refused


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ScanstageError, match="absent.ply: cannot be read"):
        read_ply(tmp_path / "absent.ply")


@pytest.mark.parametrize("wrong", [
    {"vertices": VERTICES[:, :2]}, {"faces": PYRAMID + 1}, {"faces": PYRAMID - 1}, {"faces": PYRAMID.astype(float)},
    {"vertex_colors": np.zeros((5, 3))}, {"vertex_colors": np.zeros((4, 3), np.uint8)}, {"normals": VERTICES[:2]},
    {"faces": PYRAMID, "face_colors": np.zeros((5, 3), np.uint8)},
])
def test_wrong_arrays_write_nothing(tmp_path, wrong):
    with pytest.raises(ValueError):
        write_ply(tmp_path / "a.ply", **{"vertices": VERTICES, **wrong})
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file(tmp_path):
    (tmp_path / "a.ply").mkdir()
    with pytest.raises(ScanstageError, match="a.ply: cannot be written"):
        write_ply(tmp_path / "a.ply", VERTICES)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_blender_reads_what_is_written(tmp_path):
    bpy = pytest.importorskip("bpy")
    colors = np.arange(15, dtype=np.uint8).reshape(5, 3) * 10 + 60
    write_ply(tmp_path / "a.ply", VERTICES, PYRAMID, vertex_colors=colors)
    bpy.ops.wm.ply_import(filepath=str(tmp_path / "a.ply"), forward_axis="Y", up_axis="Z")
    mesh = bpy.context.selected_objects[0].data
    np.testing.assert_array_equal([vertex.co for vertex in mesh.vertices], VERTICES)
    assert [tuple(polygon.vertices) for polygon in mesh.polygons] == [tuple(face) for face in PYRAMID.tolist()]
    # color_srgb encodes Blender's linear value again: 8 bits in, the same 8 bits out.
    shown = np.array([tuple(item.color_srgb)[:3] for item in mesh.color_attributes[0].data]) * 255
    np.testing.assert_allclose(shown, colors, atol=0.51)


@pytest.mark.parametrize("ascii_format", [False, True])
def test_what_blender_writes_is_read(tmp_path, ascii_format):
    bpy = pytest.importorskip("bpy")
    bpy.ops.mesh.primitive_monkey_add()  # triangles and quads
    mesh = bpy.context.object.data
    bpy.ops.wm.ply_export(filepath=str(tmp_path / "a.ply"), forward_axis="Y", up_axis="Z", ascii_format=ascii_format,
                          export_selected_objects=True, export_normals=True)
    read = read_ply(tmp_path / "a.ply")
    assert len(read.triangles) == sum(len(polygon.vertices) - 2 for polygon in mesh.polygons)
    # The area does not depend on the order of vertices; Suzanne's quads bend a little, so that her fans, not
    # Blender's own polygon areas, are the oracle.
    points = np.array([vertex.co for vertex in mesh.vertices])
    corners = np.array([points[[p.vertices[0], p.vertices[i], p.vertices[i + 1]]]
                        for p in mesh.polygons for i in range(1, len(p.vertices) - 1)])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert read.area() == pytest.approx(area, rel=1e-5)  # ascii has six digits
