# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras (and projectors, which are cameras run backwards), lights, rigid motions and voxel grids."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

MAX_SKEW_OF_ROTATION = 1e-5


def _vector(value, length: int, name: str) -> np.ndarray:
    array = np.array(value, dtype=np.float64)
    if array.shape != (length,) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be {length} finite numbers")
    array.flags.writeable = False
    return array


def _matrix(value, shape: tuple[int, int], name: str) -> np.ndarray:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name} must be a {shape[0]}x{shape[1]} matrix of finite numbers")
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with OpenCV's lens distortion: ``x ~ K [R | t] X``.

    Parameters
    ----------
    K : (3, 3) array
        Upper triangular, ``K[2, 2] = 1``, positive focal lengths in pixels. The centre of the top-left pixel is (0, 0).
    R : (3, 3) array
        World to camera. Orthogonal; its determinant is -1 where a calibration is mirrored (see `mirrored`).
    t : (3,) array
        ``-R @ centre``, in the world's unit.
    size : (int, int)
        Width and height in pixels.
    distortion : (5,) array
        ``k1 k2 p1 p2 k3``.

    Raises
    ------
    ValueError
        A matrix has the wrong shape, holds NaN, or is not what it must be; the message begins with the field's name.
    """

    K: np.ndarray
    R: np.ndarray
    t: np.ndarray
    size: tuple[int, int]
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))

    def __post_init__(self) -> None:
        put = object.__setattr__  # the documented way to normalise fields of a frozen dataclass
        put(self, "K", _matrix(self.K, (3, 3), "K"))
        put(self, "R", _matrix(self.R, (3, 3), "R"))
        put(self, "t", _vector(self.t, 3, "t"))
        put(self, "distortion", _vector(self.distortion, 5, "distortion"))
        put(self, "size", (int(self.size[0]), int(self.size[1])))
        if min(self.size) < 1:
            raise ValueError(f"size must be at least 1x1 pixels, not {self.size[0]}x{self.size[1]}")
        if np.tril(self.K, -1).any() or self.K[2, 2] != 1 or self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise ValueError("K must be upper triangular with positive focal lengths and K[2][2] = 1")
        if np.abs(self.R @ self.R.T - np.eye(3)).max() > MAX_SKEW_OF_ROTATION:
            raise ValueError("R must be a rotation: its rows are not orthonormal")

    @classmethod
    def from_projection(cls, P, size: tuple[int, int], towards=None) -> Camera:
        """Decompose a projection matrix, ``P ~ K [R | t]`` (Hartley & Zisserman, 2004, section 6.2.4).

        Parameters
        ----------
        P : (3, 4) array
            Of any scale and sign.
        size : (int, int)
        towards : (3,) array, optional
            A point that must lie in front of the camera; it settles the sign of P. A mirrored calibration then gives
            a Camera with ``det R = -1``. Without it the sign is the one that makes R a rotation.

        Raises
        ------
        ValueError
            The left 3x3 part of P is singular: the camera's centre lies at infinity.
        """
        P = np.array(_matrix(P, (3, 4), "P"))
        scale = np.linalg.norm(P[2, :3])
        if scale == 0 or abs(np.linalg.det(P[:, :3] / scale)) < 1e-12:
            raise ValueError("P must have an invertible left 3x3 part")
        P /= scale
        if towards is None:
            P *= np.sign(np.linalg.det(P[:, :3]))
        else:
            P *= np.sign(P[2] @ np.append(towards, 1.0)) or 1.0
        flip = np.eye(3)[::-1]
        q, r = np.linalg.qr((flip @ P[:, :3]).T)  # RQ decomposition by QR of the row- and column-reversed transpose
        K, R = flip @ r.T @ flip, flip @ q.T
        signs = np.sign(np.diag(K))
        K, R = K * signs, R * signs[:, None]
        t = np.linalg.solve(K, P[:, 3])
        K = np.triu(K / K[2, 2])
        return cls(K, R, t, size)

    @property
    def P(self) -> np.ndarray:
        """The (3, 4) projection matrix, without distortion."""
        return self.K @ np.column_stack((self.R, self.t))

    @property
    def centre(self) -> np.ndarray:
        """The (3,) centre of projection in the world."""
        return -self.R.T @ self.t

    @property
    def forward(self) -> np.ndarray:
        """The (3,) unit direction of the optical axis in the world."""
        return self.R[2]

    @property
    def mirrored(self) -> bool:
        """Whether the calibration turns the world into its mirror image (``det R = -1``)."""
        return bool(np.linalg.det(self.R) < 0)

    @property
    def distorted(self) -> bool:
        """Whether any distortion coefficient is not zero."""
        return bool(self.distortion.any())

    def project(self, points) -> tuple[np.ndarray, np.ndarray]:
        """Project points.

        Parameters
        ----------
        points : (..., 3) array
            In the world.

        Returns
        -------
        pixels : (..., 2) array
            Meaningless where the depth is not positive.
        depth : (...) array
            Along the optical axis, in the world's unit.
        """
        points = np.asarray(points, dtype=np.float64)
        # A product of many 3-vectors is what BLAS is slowest at: OpenCV's takes a fraction of the time.
        local = cv2.transform(points.reshape(-1, 1, 3), np.column_stack((self.R, self.t))).reshape(points.shape) if points.size else points
        depth = local[..., 2]
        ideal = local[..., :2] / np.where(depth == 0, np.nan, depth)[..., None]
        x, y = np.moveaxis(distort(ideal, self.distortion) if self.distorted else ideal, -1, 0)
        K = self.K
        return np.stack((K[0, 0] * x + K[0, 1] * y + K[0, 2], K[1, 1] * y + K[1, 2]), axis=-1), depth

    def rays(self, pixels) -> np.ndarray:
        """Return the (..., 3) directions, in the world and with unit depth, of undistorted pixels (..., 2)."""
        pixels = np.asarray(pixels, dtype=np.float64)
        ones = np.ones(pixels.shape[:-1] + (1,))
        return np.concatenate((pixels, ones), axis=-1) @ (self.R.T @ np.linalg.inv(self.K)).T

    def moved(self, motion) -> Camera:
        """Return the camera as seen from a frame that lies at ``motion`` in the world.

        Parameters
        ----------
        motion : (4, 4) array
            Rigid motion from the new frame to the world (a turntable's ``object_to_world``).
        """
        motion = np.asarray(motion, dtype=np.float64)
        return replace(self, R=self.R @ motion[:3, :3], t=self.R @ motion[:3, 3] + self.t)

    def scaled(self, factor: float) -> Camera:
        """Return the camera of the same picture resampled to ``factor`` times its size (rounded up to whole pixels).

        The pixels' outer edges, not their centres, are what resampling keeps: ``u' + 0.5 = factor * (u + 0.5)``.
        """
        edge = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]])
        width, height = (max(1, int(np.ceil(n * factor - 1e-9))) for n in self.size)
        return replace(self, K=edge @ self.K, size=(width, height))


@dataclass(frozen=True)
class Light:
    """A light of a rig, in the world.

    Parameters
    ----------
    kind : {'point', 'sun', 'spot'}
    position : (3,) array, optional
        Of a point or spot light.
    direction : (3,) array, optional
        Unit vector along which a sun or spot light shines.
    radius : float
        Of the luminous sphere, in the scene's unit; 0 casts hard shadows.
    """

    kind: str
    position: np.ndarray | None = None
    direction: np.ndarray | None = None
    radius: float = 0.0

    def moved(self, motion) -> Light:
        """Return the light as seen from a frame that lies at ``motion`` (4, 4) in the world: see `Camera.moved`."""
        motion = np.asarray(motion, dtype=np.float64)
        rotation, offset = motion[:3, :3], motion[:3, 3]
        position = None if self.position is None else (np.asarray(self.position) - offset) @ rotation
        direction = None if self.direction is None else np.asarray(self.direction) @ rotation
        return replace(self, position=position, direction=direction)


def distort(points, distortion) -> np.ndarray:
    """Apply lens distortion to normalised image coordinates (Brown, 1971; OpenCV's five coefficients).

    Parameters
    ----------
    points : (..., 2) array
        ``X / Z, Y / Z`` in the camera's frame.
    distortion : (5,) array
        ``k1 k2 p1 p2 k3``.

    Returns
    -------
    (..., 2) array
    """
    points = np.asarray(points, dtype=np.float64)
    k1, k2, p1, p2, k3 = distortion
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack((x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                     y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y), axis=-1)


def look_at(centre, target, up=(0.0, 0.0, 1.0)) -> tuple[np.ndarray, np.ndarray]:
    """Return R (3, 3) and t (3,) of a camera at ``centre`` that looks at ``target`` with ``up`` upward in the picture.

    Raises
    ------
    ValueError
        The viewing direction is zero or parallel to ``up``.
    """
    centre = _vector(centre, 3, "centre")
    forward = _vector(target, 3, "target") - centre
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > 1e-12 * np.linalg.norm(forward):
        raise ValueError("the viewing direction must not be zero or parallel to up")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    R = np.stack((right, np.cross(forward, right), forward))
    return R, -R @ centre


def rotation_about(axis, angle: float) -> np.ndarray:
    """Return the (3, 3) rotation by ``angle`` radians about ``axis`` (Rodrigues' formula)."""
    x, y, z = _vector(axis, 3, "axis") / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


@dataclass(frozen=True)
class VoxelGrid:
    """Where a volume's voxels lie: voxel ``(i, j, k)`` covers ``origin + voxel_size * [i, i + 1) x ...``.

    Parameters
    ----------
    origin : (3,) array
        The lower corner of voxel (0, 0, 0) in the object frame.
    voxel_size : float
        Edge length, in the scene's unit.
    shape : (int, int, int)
        Number of voxels along x, y, z.
    """

    origin: np.ndarray
    voxel_size: float
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", _vector(self.origin, 3, "origin"))
        object.__setattr__(self, "voxel_size", float(self.voxel_size))
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        if not (np.isfinite(self.voxel_size) and self.voxel_size > 0):
            raise ValueError(f"voxel_size must be positive, not {self.voxel_size}")
        if len(self.shape) != 3 or min(self.shape) < 1:
            raise ValueError(f"shape must be three counts of at least 1, not {self.shape}")

    @classmethod
    def from_bounds(cls, lower, upper, voxels: int) -> VoxelGrid:
        """Divide a box so that its longest side has ``voxels`` voxels.

        The lower corner is kept; along the shorter sides the last voxel may reach beyond the upper one.

        Raises
        ------
        ValueError
            The box has no volume, or ``voxels`` is less than 1.
        """
        lower, upper = _vector(lower, 3, "lower"), _vector(upper, 3, "upper")
        extent = upper - lower
        if not (extent > 0).all():
            raise ValueError("the box has no volume: every upper bound must be greater than its lower bound")
        if voxels < 1:
            raise ValueError(f"the number of voxels must be at least 1, not {voxels}")
        voxel_size = extent.max() / voxels
        return cls(lower, voxel_size, tuple(np.maximum(1, np.ceil(extent / voxel_size - 1e-6)).astype(int)))

    @property
    def upper(self) -> np.ndarray:
        """The (3,) upper corner."""
        return self.origin + self.voxel_size * np.array(self.shape)

    @property
    def count(self) -> int:
        """The number of voxels."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    def centres(self, voxels) -> np.ndarray:
        """Return the (..., 3) centres of voxels given by (..., 3) indices."""
        return self.origin + self.voxel_size * (np.asarray(voxels) + 0.5)
