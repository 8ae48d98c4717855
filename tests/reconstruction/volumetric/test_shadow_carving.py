# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow carving on analytic scenes: what is carved is empty, by proof and by test, and hollows are carved.

Shapes are balls and boxes, so that silhouettes, shadows and insides are formulas.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon.errors import ScanstageError
from addon.reconstruction.geometry import Light, VoxelGrid, rotation_about
from addon.reconstruction.scan import LitPicture, Scan, View
from addon.reconstruction.shadows import ShadowMasks
from addon.reconstruction.volumetric import shadow_carving
from addon.reconstruction.volumetric.shadow_carving import shadow_carving as carve
from addon.reconstruction.volumetric.volume import SparseVolume
from tests.naive_shadows import naive
from tests.rigs import Ball, Box, black_picture, camera_at, in_shadow, ring, silhouette

GRID = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 40)
UPRIGHT = np.eye(3)
# A tray: a floor with four walls, whose hollow no silhouette of a ring of low cameras shows.
TRAY = [Box((0, 0, -0.5), (0.6, 0.6, 0.1), UPRIGHT), *(Box((x, y, -0.15), half, UPRIGHT) for x, y, half in (
    (0.55, 0, (0.05, 0.6, 0.35)), (-0.55, 0, (0.05, 0.6, 0.35)), (0, 0.55, (0.6, 0.05, 0.35)), (0, -0.55, (0.6, 0.05, 0.35))))]


def eroded(mask, margin=1):
    return cv2.erode(mask.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0


def lights_about(camera, spread, count=2, turn=0.0):
    """Return the positions of lights on a circle round a camera, ``spread`` degrees off its axis as seen from the origin."""
    away = np.linalg.norm(camera.centre)
    radius = away * np.tan(np.radians(spread))
    angles = turn + 2 * np.pi * np.arange(count) / count
    return [camera.centre + radius * (np.cos(a) * camera.R[0] + np.sin(a) * camera.R[1]) for a in angles]


def lit_view(name, camera, shapes, lights, *, drop=None):
    """Return a view with perfect silhouette and shadows; both with the margins that sampling at pixels' centres asks for."""
    mask = cv2.dilate(silhouette(camera, shapes).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    bits = np.zeros(mask.shape, np.uint8)
    for number, position in enumerate(lights):
        shadow = eroded(in_shadow(camera, position, shapes))
        if drop is not None:
            shadow &= drop.random(mask.shape) < 0.5
        bits |= shadow.astype(np.uint8) << np.uint8(number)
    lit = tuple(LitPicture(f"{name}-{n}", f"light-{n}", Light("point", position), black_picture) for n, position in enumerate(lights))
    return View(name, camera, mask, black_picture, lit, ShadowMasks(bits, mask))


def scan_of(cameras, shapes, *, spread=30.0, count=2, turn=0.3, drop=None):
    return Scan(tuple(lit_view(f"{n:02d}", camera, shapes, lights_about(camera, spread, count, turn), drop=drop)
                      for n, camera in enumerate(cameras)))


def wholly_inside(grid, shapes):
    """Return (nx, ny, nz) bool: the voxels all of whose corners and whose centre lie in one shape (all are convex)."""
    corners = grid.origin + grid.voxel_size * np.stack(np.meshgrid(*(np.arange(n + 1) for n in grid.shape), indexing="ij"), -1)
    whole = np.zeros(grid.shape, bool)
    for shape in shapes:
        c = shape.contains(corners)
        c = c[:-1] & c[1:]
        c = c[:, :-1] & c[:, 1:]
        whole |= c[:, :, :-1] & c[:, :, 1:]
    return whole


# --- nothing of the object is ever removed ------------------------------------------------------------------------------------

coordinate = st.floats(-0.45, 0.45)
balls = st.builds(Ball, st.tuples(coordinate, coordinate, coordinate), st.floats(0.15, 0.45))
boxes = st.builds(lambda centre, half, axis, angle: Box(centre, half, rotation_about(np.array(axis) + (0, 0, 1e-3), angle)),
                  st.tuples(coordinate, coordinate, coordinate), st.tuples(*[st.floats(0.06, 0.4)] * 3),
                  st.tuples(*[st.floats(-1, 1)] * 3), st.floats(0, 3))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(balls | boxes, min_size=1, max_size=4), st.integers(3, 6), st.floats(-20, 60), st.floats(10, 55), st.integers(1, 3),
       st.floats(0, 6), st.sampled_from(["strict", "safe"]))
def test_no_voxel_of_the_object_is_removed(shapes, views, elevation, spread, lights, turn, rule):
    scan = scan_of(ring(views, elevation=elevation, size=(200, 150), focal=250.0), shapes, spread=spread, count=lights, turn=turn)
    try:
        found = carve(scan, GRID, shadow_rule=rule)
    except ScanstageError as error:
        assert "no shadow is seen" in str(error)
        return
    # Volumes only shrink from round to round: what is whole at the end was whole after every step.
    assert not (wholly_inside(GRID, shapes) & ~found.volume.dense()).any()


def test_the_naive_rule_would_be_found_out():
    shapes = [Ball((0, 0, 0), 0.35), Ball((0.45, 0.1, 0.2), 0.2), Ball((-0.3, 0.4, -0.2), 0.25), Box((0, -0.5, 0), (0.3, 0.08, 0.3), UPRIGHT)]
    scan = scan_of(ring(6, elevation=25, size=(200, 150), focal=250.0), shapes, count=3)
    found = carve(scan, GRID)
    whole = wholly_inside(GRID, shapes)
    assert not (whole & ~found.volume.dense()).any()
    hull = SparseVolume.from_dense(GRID, found.volume.dense() | _carved(found))
    assert (whole & naive(scan, hull)).any()


def _carved(found):
    out = np.zeros(GRID.shape, bool)
    out[tuple(found.layers["carved"].voxels.T)] = True
    return out


def slit_scene():
    """Return a camera, a light, shapes and a volume round them, in which the light meets, through a slit, a face that no pixel shows.

    The camera looks along y. Light from far to the left passes between a front and a back blocker and meets the left
    face of a block, which its front hides; that front, and the wall behind the gap, lie in the blockers' shadows.
    """
    along, across = np.array([0.5, 1.5]) / np.hypot(0.5, 1.5), np.array([1.5, -0.5]) / np.hypot(0.5, 1.5)
    middle = np.array([1.0, 10.0]) + 0.8 * along + 1.2 * across
    turned = np.column_stack(((*across, 0), (*along, 0), (0, 0, 1)))
    block = Box((*middle, 0), (1.2, 0.8, 0.4), turned)
    shapes = [block, Box((-2.5, 6.7, 0), (0.5, 1.7, 0.4), UPRIGHT), Box((-2.5, 11.1, 0), (0.5, 1.95, 0.4), UPRIGHT),
              Box((0, 14.5, 0), (3.0, 0.5, 0.4), UPRIGHT)]
    excess = Box((0, 10.45, 0), (1.0, 0.55, 0.4), UPRIGHT)
    grid = VoxelGrid.from_bounds((-4, 4, -0.6), (5, 16, 0.6), 240)
    centres = grid.centres(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1))
    occupied = np.any([shape.contains(centres) for shape in (*shapes, excess)], axis=0)
    volume = SparseVolume.from_dense(grid, cv2.dilate(occupied.astype(np.uint8).reshape(grid.shape[0], -1), np.ones((3, 1), np.uint8))
                                     .reshape(grid.shape) > 0)
    camera = camera_at((0, 0, 0), (0, 10, 0), focal=900.0, size=(700, 120))
    return camera, np.array([-20.0, 0, 0]), shapes, block, volume


@pytest.mark.parametrize("rule, cuts", [("strict", False), ("safe", True)])
def test_light_through_a_slit_tells_the_proven_rule_from_the_other(rule, cuts):
    camera, light, shapes, block, volume = slit_scene()
    view = lit_view("0", camera, shapes, [light])
    sight = shadow_carving.Sight.of(volume, strict=rule == "strict")
    (_, _, voxels), = sight.removals([view], lambda *_: None)
    inner = replace(block, half=tuple(np.array(block.half) - 1.5 * volume.grid.voxel_size))
    assert inner.contains(volume.grid.centres(voxels)).any() == cuts


# --- and what is empty is --------------------------------------------------------------------------------------------------------

@pytest.fixture(scope="module")
def tray():
    """The tray from two rings: low views cut its outline, high ones see into it."""
    cameras = [*ring(8, elevation=5, size=(320, 240), focal=400.0), *ring(8, elevation=55, size=(320, 240), focal=400.0)]
    return scan_of(cameras, TRAY, count=3, spread=35)


def inside_of_the_tray(grid):
    centres = grid.centres(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1))
    return Box((0, 0, -0.1), (0.5, 0.5, 0.3), UPRIGHT).contains(centres)


def test_the_hollow_of_a_tray_is_carved(tray):
    found = carve(tray, GRID)
    hollow = inside_of_the_tray(GRID)
    hull = found.volume.dense() | _carved(found)
    assert (hull & hollow).sum() > 0.6 * hollow.sum()  # no silhouette shows it
    assert (found.volume.dense() & hollow).sum() < 0.8 * (hull & hollow).sum()  # 20 x 20 x 12 voxels, less two all round
    assert not (wholly_inside(GRID, TRAY) & ~found.volume.dense()).any()


def test_half_of_the_shadow_pixels_are_enough_to_be_safe_and_carve_less(tray):
    """Each pixel is dropped by a coin, so that hardly a run of shadow is whole."""
    sparse = scan_of([view.camera for view in tray.views], TRAY, count=3, spread=35, drop=np.random.default_rng(1))
    whole, half = carve(tray, GRID), carve(sparse, GRID)
    assert not (wholly_inside(GRID, TRAY) & ~half.volume.dense()).any()
    assert whole.volume.count() < half.volume.count() <= half.report["counts"]["hull"]
    assert (half.volume.dense() | ~whole.volume.dense()).all()  # fewer shadow pixels never remove another voxel


def test_views_may_come_in_any_order(tray):
    backward = Scan(tray.views[::-1])
    assert (carve(tray, GRID).volume.dense() == carve(backward, GRID).volume.dense()).all()


def test_every_carved_voxel_knows_its_view_light_and_round(tray):
    found = carve(tray, GRID)
    layer, named = found.layers["carved"], found.report["carved_by"]
    counts = found.report["counts"]
    assert len(layer.voxels) == counts["carved"] == counts["hull"] - found.volume.count() > 0
    assert len(np.unique(layer.voxels, axis=0)) == len(layer.voxels)
    assert named["lights"] == ["light-0", "light-1", "light-2"] and named["views"] == [view.name for view in tray.views]
    assert layer.values["round"].max() < counts["rounds"] and layer.values["round"].min() == 0
    # A carved voxel was not lit: it lies behind the shadow of its own view and light. All but the margin of pixels say so.
    centres = GRID.centres(layer.voxels)
    in_its_shadow = np.zeros(len(centres), bool)
    for (view, light) in {*zip(layer.values["view"].tolist(), layer.values["light"].tolist(), strict=True)}:
        rows = np.flatnonzero((layer.values["view"] == view) & (layer.values["light"] == light))
        column, row = np.rint(tray.views[view].camera.project(centres[rows])[0]).astype(int).T
        in_its_shadow[rows] = tray.views[view].shadows.of(light)[row, column]
    assert in_its_shadow.all()
    assert found.pictures and set(found.pictures) <= {"light-image-light-0", "light-image-light-1", "light-image-light-2"}
    assert all(picture.dtype == np.uint8 and picture.shape[2] == 3 and picture.std() > 0 for picture in found.pictures.values())


def test_one_round_is_part_of_what_more_rounds_do(tray):
    one, all_ = carve(tray, GRID, rounds=1), carve(tray, GRID)
    assert one.report["counts"]["rounds"] == 1 < all_.report["counts"]["rounds"]
    assert (one.volume.dense() | ~all_.volume.dense()).all() and all_.volume.count() <= one.volume.count()


def test_a_convex_object_loses_only_what_the_hull_added():
    ball = [Ball((0, 0, 0), 0.6)]
    found = carve(scan_of(ring(8, size=(200, 150), focal=250.0), ball, count=3), GRID)
    assert not (wholly_inside(GRID, ball) & ~found.volume.dense()).any()


def test_lens_distortion_is_allowed_for():
    """A lens that is bent by 3 pixels at the corners: the straight pictures, resampled as such a lens shows them."""
    plain = scan_of(ring(6, elevation=50, size=(320, 240), focal=400.0), TRAY, count=2)
    distortion = np.array([-0.12, 0.02, 0, 0, 0])
    views = []
    for view in plain.views:
        bent = replace(view.camera, distortion=distortion)
        pixels = np.stack(np.meshgrid(np.arange(320.0), np.arange(240.0)), -1).reshape(-1, 1, 2)
        ideal = cv2.undistortPoints(pixels, bent.K, distortion, None, None, bent.K).reshape(240, 320, 2).astype(np.float32)

        def shown(values, ideal=ideal):
            return cv2.remap(values.astype(np.uint8), ideal, None, cv2.INTER_NEAREST)

        bits = np.bitwise_or.reduce([(eroded(shown(view.shadows.of(n)))).astype(np.uint8) << np.uint8(n) for n in range(2)])
        mask = cv2.dilate(shown(view.mask), np.ones((3, 3), np.uint8)) > 0
        views.append(replace(view, camera=bent, mask=mask, shadows=ShadowMasks(bits, mask)))
    found = carve(Scan(tuple(views)), GRID)
    assert not (wholly_inside(GRID, TRAY) & ~found.volume.dense()).any()
    assert found.report["counts"]["carved"] > 0.6 * carve(plain, GRID).report["counts"]["carved"]


def test_a_sun_is_a_light_far_away():
    cameras = ring(6, elevation=50, size=(200, 150), focal=250.0)
    views = []
    for n, camera in enumerate(cameras):
        direction = -lights_about(camera, 35, 1)[0] / np.linalg.norm(lights_about(camera, 35, 1)[0])
        view = lit_view(f"{n}", camera, TRAY, [-1e5 * direction])
        views.append(replace(view, lit=(replace(view.lit[0], light=Light("sun", None, direction)),)))
    found = carve(Scan(tuple(views)), GRID)
    assert found.report["counts"]["carved"] > 100 and not (wholly_inside(GRID, TRAY) & ~found.volume.dense()).any()


# --- bad input ---------------------------------------------------------------------------------------------------------------------

def with_light(scan, light, unused=()):
    views = tuple(replace(view, lit=tuple(replace(picture, light=light) for picture in view.lit)) for view in scan.views)
    return Scan(views, unused_lights=unused)


@pytest.mark.parametrize("change, words", [
    (lambda scan: with_light(scan, Light("point", np.array([0.1, 0.0, -0.1]))), "light-0: stands inside the volume"),
    (lambda scan: with_light(scan, Light("point", np.array([0.0, 0.0, 0.3]))), "light-0: stands too near"),
    (lambda scan: with_light(scan, Light("spot", np.array([3.0, 0, 0]), np.array([-1.0, 0, 0]))), "light-0: is a spot light"),
    (lambda scan: Scan(scan.views, unused_lights=("lamp-7",)), "lamp-7: is on in no frame"),
    (lambda scan: Scan(tuple(replace(view, lit=()) for view in scan.views)), "no frame that a single light lights alone"),
    (lambda scan: Scan(tuple(replace(view, shadows=None) for view in scan.views)), "frame 00 has no shadow masks"),
    (lambda scan: Scan(tuple(replace(view, shadows=ShadowMasks(view.shadows.bits * 0, view.mask)) for view in scan.views)),
     "no shadow is seen in any frame"),
    (lambda scan: Scan(()), "no frame that a single light lights alone"),
])
def test_lights_that_cannot_be_used_are_named_in_one_sentence(tray, change, words):
    with pytest.raises(ScanstageError, match=words) as caught:
        carve(change(tray), GRID)
    assert "\n" not in str(caught.value)


def test_a_light_without_a_visible_shadow_and_views_without_lights_are_warned_of(tray):
    views = [replace(view, shadows=ShadowMasks(view.shadows.bits & 0b101, view.mask)) for view in tray.views]
    views[3] = replace(views[3], lit=())
    warnings = " | ".join(carve(Scan(tuple(views)), GRID, rounds=1).report["warnings"])
    assert "light-1: no frame shows a shadow of it" in warnings
    assert "1 of 16 views have no frame under a single light (first: 03)" in warnings
