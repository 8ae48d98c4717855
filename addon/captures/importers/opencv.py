# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras in OpenCV's FileStorage (XML, YAML or JSON), with the pictures in the same folder.

Three layouts, which may be mixed in one file:

- a 3x4 matrix a picture, ``viff007_matrix`` or ``P_7``: the projection matrix, of any scale, sign and handedness;
- a map a picture, ``view_7``, with ``P``, or with ``R`` and ``t`` and perhaps ``K`` and ``distortion``;
- a sequence ``frames`` of such maps, each with ``image``, the picture's name.

``K`` and ``distortion`` at the top of the file hold for every map that has none. OpenCV's own names mean the same:
``camera_matrix``, ``distortion_coefficients``, ``rvec`` or ``rotation`` (3 values are a Rodrigues vector), ``tvec`` or
``translation``. R and t are world to camera. A matrix or map belongs to the picture of the same name or, failing that,
to the one with the same number: ``viff007_matrix`` to ``image_7.jpg``. Pictures without a camera are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from ...errors import ScanstageError
from ...reconstruction.geometry import Camera
from ...reconstruction.volumetric.bounds import meeting_point
from ..fields import MAX_NUMBER
from .sources import Import, assemble, camera_from, checked_size, own_file, pictures_in, read_text

NAMES = {"P": ("P", "projection_matrix", "projection"),
         "K": ("K", "camera_matrix", "cameraMatrix", "M", "intrinsics"),
         "distortion": ("distortion", "distortion_coefficients", "dist_coeffs", "distCoeffs", "D"),
         "R": ("R", "rotation", "rotation_matrix", "rvec"),
         "t": ("t", "T", "translation", "tvec")}
_MAX_DEPTH = 100
_MAX_INDENT = 400
_LONG_NUMBER = re.compile(r"(?<![\w.+\-])[+-]?\d{10,}(?=[\s,\]}<]|$)")
_LONG_HEXADECIMAL = re.compile(r"(?<![\w.])[+-]?0[xX][0-9a-fA-F]{8,}")
_LEAST_SPREAD = 1e-4  # of the optical axes: below, the point at which they meet says nothing


def read_opencv(source: Path) -> Import:
    """Read a calibration and find its pictures.

    Parameters
    ----------
    source : Path
        The file, or a folder that holds one such file.

    Raises
    ------
    ScanstageError
        The file cannot be read, a matrix is not what it must be, or a picture is not there.
    """
    path = calibration_file(source)
    with open_storage(path) as storage:
        found = _found(storage.root(), path)
    if not found:
        raise ScanstageError(f"{path.name}: holds no 3x4 matrix and no K, R and t for a picture; "
                             "check that it is the right file")
    return assemble(_cameras(found, path.name))


def _found(root: cv2.FileNode, path: Path) -> list[tuple[str, Path, dict[str, np.ndarray]]]:
    """Return the name of each node that stands for a camera, its picture, and its matrices."""
    pictures = pictures_in(path.parent)
    shared = named_matrices(root, path.name)
    shared = {name: shared[name] for name in ("K", "distortion") if name in shared}
    found = []
    for name, node in _nodes(root, path.name):
        matrices = {"P": read_matrix(node, f"{path.name}: {name}")} if _is_matrix(node) \
            else {**shared, **named_matrices(node, f"{path.name}: {name}")}
        if matrices.get("P", np.zeros(0)).shape == (3, 4) or {"K", "R", "t"} <= matrices.keys():
            found.append((name, _picture(node, name, path, pictures), matrices))
    return found


def calibration_file(source: Path) -> Path:
    """Return the calibration of a source: itself, or the only such file in a folder.

    Raises
    ------
    ScanstageError
        The folder holds none, or several.
    """
    if source.is_file():
        return source
    found = [path for path in sorted(source.iterdir()) if path.suffix.lower() in (".xml", ".yml", ".yaml", ".json")]
    if len(found) != 1:
        raise ScanstageError(f"{source}: holds {len(found)} XML, YAML or JSON files where one is needed; "
                             "give the file itself")
    return own_file(source, found[0].name)


@contextmanager
def open_storage(path: Path) -> Iterator[cv2.FileStorage]:
    """Open a file of OpenCV's FileStorage that nobody vouches for; its nodes are good for as long as it is open.

    Raises
    ------
    ScanstageError
        It is none, or would overflow OpenCV's parsers, or (from within the block too) is damaged.
    """
    text = read_text(path)
    _refuse_nesting(text, path.name)
    # Where a whole number does not fit 32 bits OpenCV 4.11 leaves too little room for it: what comes after it is read as anything,
    # without an end. As a fraction it fits.
    text = _LONG_NUMBER.sub(r"\g<0>.", text)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        if not storage.isOpened() or not storage.root().isMap() or _LONG_HEXADECIMAL.search(text):
            raise ScanstageError(f"{path.name}: is not a file of OpenCV's FileStorage; check that it is the right file")
        yield storage
    except (cv2.error, SystemError, UnicodeError):  # what OpenCV's constructor raises from Python is one wrapped in the other
        raise ScanstageError(f"{path.name}: is not a file of OpenCV's FileStorage, or damaged; check that it is the right file") from None


def _refuse_nesting(text: str, name: str) -> None:
    """Refuse what would overflow the stack of OpenCV's parsers, which recurse without a limit."""
    depth = deepest = 0
    for token in re.finditer(r"</|/>|<(?![?!])|[\[{]|[\]}]", text):
        depth += -1 if token[0] in ("</", "/>", "]", "}") else 1
        deepest = max(deepest, depth)
    if deepest > _MAX_DEPTH or re.search(rf"^ {{{_MAX_INDENT},}}\S|(?:-\s+){{{_MAX_DEPTH},}}", text, re.MULTILINE):
        raise ScanstageError(f"{name}: is nested too deeply; check that it is the right file")


def _nodes(root: cv2.FileNode, file: str) -> list[tuple[str, cv2.FileNode]]:
    nodes = [(key, root.getNode(key)) for key in root.keys()]
    frames = root.getNode("frames")
    if not frames.empty() and frames.isSeq():
        nodes += [(f"frames[{index}]", frames.at(index)) for index in range(frames.size())]
    taken = {spelling for spellings in NAMES.values() for spelling in spellings}
    return [(name, node) for name, node in nodes if node.isMap() and name not in taken]


def _is_matrix(node: cv2.FileNode) -> bool:
    return node.isMap() and not node.getNode("rows").empty() and not node.getNode("data").empty()


def read_matrix(node: cv2.FileNode, place: str) -> np.ndarray:
    """Return a matrix, or a plain list of numbers as a row; empty if it is neither or larger than any camera's."""
    if node.isSeq():
        shape, data = (1, node.size()), node
    elif _is_matrix(node):
        shape, data = [node.getNode(name).real() for name in ("rows", "cols")], node.getNode("data")
        if not all(0 <= side <= 16 for side in shape):  # a damaged file may say infinity
            return np.zeros(0)
        shape = tuple(map(int, shape))
    else:
        return np.zeros(0)
    if not 0 < shape[0] * shape[1] <= 16:
        return np.zeros(0)
    # Not FileNode.mat(): it returns garbage where a whole number stands among a matrix of doubles.
    numbers = [data.at(index) for index in range(data.size())] if data.isSeq() else []
    if len(numbers) != shape[0] * shape[1] or not all(number.isReal() or number.isInt() for number in numbers):
        raise ScanstageError(f"{place}: does not hold {shape[0]}x{shape[1]} plain numbers; correct it")
    value = np.array([number.real() for number in numbers]).reshape(shape)
    if not (np.abs(value) <= MAX_NUMBER).all():
        raise ScanstageError(f"{place}: a number is not finite or is too large; correct it")
    return value


def named_matrices(node: cv2.FileNode, place: str) -> dict[str, np.ndarray]:
    """Return those of P, K, distortion, R and t that a map holds, whichever of `NAMES` it calls them."""
    keys = set(node.keys())
    found = {}
    for name, spellings in NAMES.items():
        spelling = next((spelling for spelling in spellings if spelling in keys), None)
        if spelling is not None:
            found[name] = read_matrix(node.getNode(spelling), f"{place}: {spelling}")
    return found


def _picture(node: cv2.FileNode, name: str, path: Path, pictures: list[Path]) -> Path:
    place = f"{path.name}: {name}"
    image = node.getNode("image")
    if not image.empty() and image.isString():
        matching = [picture for picture in pictures if picture.name == image.string()]
        wanted = image.string()[:100]
    else:
        wanted = _number(name)
        matching = [picture for picture in pictures if picture.stem == name] \
            or [picture for picture in pictures if wanted is not None and _number(picture.stem) == wanted]
    if len(matching) != 1:
        known = "no picture" if not matching else f"{len(matching)} pictures"
        raise ScanstageError(f"{place}: {known} in {path.parent} matches {wanted}; "
                             "name one picture so, or give its name as image")
    return matching[0]


def _number(name: str) -> int | None:
    numbers = re.findall(r"\d+", name)
    return int(numbers[-1]) if numbers and len(numbers[-1]) < 16 else None


def _cameras(found: list[tuple[str, Path, dict]], file: str) -> list[tuple[Path, Camera]]:
    """Return the pictures' cameras; the sign of each P is settled by the point at which all of them look."""
    cameras = []
    for name, picture, matrices in found:
        place = f"{file}: {name}"
        size = checked_size(picture, place)
        cameras.append(_decomposed(matrices["P"], size, None, place) if "P" in matrices
                       else compose_camera(matrices, size, place))
    axes = np.array([camera.forward for camera in cameras])
    spread = np.linalg.eigvalsh(np.eye(3) - axes.T @ axes / len(axes))[0]
    if spread > _LEAST_SPREAD:
        middle = meeting_point(cameras)
        cameras = [_decomposed(matrices["P"], camera.size, middle, f"{file}: {name}") if "P" in matrices else camera
                   for (name, _, matrices), camera in zip(found, cameras, strict=True)]
    return [(picture, camera) for (_, picture, _), camera in zip(found, cameras, strict=True)]


def _decomposed(P: np.ndarray, size: tuple[int, int], towards: np.ndarray | None, place: str) -> Camera:
    try:
        return Camera.from_projection(P, size, towards)
    except ValueError as error:
        raise ScanstageError(f"{place}: {error}; correct the calibration") from None


def compose_camera(matrices: dict[str, np.ndarray], size: tuple[int, int], place: str) -> Camera:
    """Return the camera of K, R (or a Rodrigues vector), t and perhaps a distortion.

    Raises
    ------
    ScanstageError
        One of them is not what it must be.
    """
    R = matrices["R"]
    if R.size == 3:
        R = cv2.Rodrigues(R.reshape(3))[0]
    distortion = np.zeros(5)
    given = matrices.get("distortion", distortion).ravel()
    if len(given) > 5 and given[5:].any():
        raise ScanstageError(f"{place}: has {len(given)} distortion coefficients; "
                             "calibrate again with OpenCV's five (k1 k2 p1 p2 k3)")
    distortion[:min(len(given), 5)] = given[:5]
    for name, value, shape in (("K", matrices["K"], (3, 3)), ("R", R, (3, 3))):
        if value.shape != shape:
            raise ScanstageError(f"{place}: {name} must be a 3x3 matrix; correct the calibration")
    return camera_from(matrices["K"], R, matrices["t"].ravel(), distortion, size, place)
