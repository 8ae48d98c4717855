# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the rig over the 3-D views: devices, working volume, turntable, coverage, the live hull, names and a legend.

Two handlers draw, one in the space of the view and one in its pixels. What they send to the graphics card is made once and kept until
the scene or what is known of it has changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import blf
import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix

from ..errors import ScanstageError
from ..stage import ownership, readback, sketch
from ..stage.projected import projected_pictures
from ..stage.units import length_text
from . import watching
from .coverage import Legend, colors_of, shaded

COLORS = {  # as screens show them
    sketch.CAMERA: (1.0, 0.72, 0.25), sketch.VIEW: (1.0, 0.72, 0.25), sketch.PROJECTOR: (0.36, 0.74, 1.0),
    sketch.LIGHT: (1.0, 0.95, 0.55), sketch.LASER: (1.0, 0.27, 0.2), sketch.SHADOW: (0.62, 0.56, 0.9),
    sketch.VOLUME: (0.5, 0.87, 0.6), sketch.TURNTABLE: (0.85, 0.87, 0.92)}
HULL = np.array([0.95, 0.55, 0.3])
_WIDTH = {True: 1.8, False: 1.0}  # of lines, in pixels: of what takes part in the present frame, and of what does not
_ALPHA = {True: 0.9, False: 0.4}
_BEHIND = 0.16  # of a line's alpha, where something is before it
_FACE_ALPHA, _PICTURE_ALPHA = 0.13, 0.75
_MOST_PIXELS = 1 << 22  # of patterns that are read from Blender to be drawn
_ON_SURFACE, _BEFORE_SURFACE = 0.998, 0.994  # of the distance: where coverage and hull are drawn, so that they lie on the object
_TEXT, _SMALL = 12, 11
_INK, _PLATE = (0.95, 0.95, 0.95, 1.0), (0.08, 0.08, 0.09, 0.62)
_EDGE, _SWATCH, _ROW, _LEGEND_WIDTH = 18, 14, 19, 190


class _Drawn:
    """What lies on the graphics card, and what it was made from."""

    def __init__(self) -> None:
        self.handles: list = []
        self.old = True
        self.version = -1
        self.sketches: list[sketch.Sketch] = []
        self.batches: list[tuple[sketch.Sketch, gpu.types.GPUBatch | None, gpu.types.GPUBatch | None]] = []
        self.pictures: list[tuple[str, gpu.types.GPUBatch]] = []
        self.textures: dict[int, gpu.types.GPUTexture] = {}
        self.surface_key: tuple = ()
        self.coverage: gpu.types.GPUBatch | None = None
        self.hull: gpu.types.GPUBatch | None = None
        self.legend: Legend | None = None


_drawn = _Drawn()


def sketches_of(scene: bpy.types.Scene, settings: bpy.types.PropertyGroup) -> Iterator[sketch.Sketch]:
    """Yield what the settings switch on, as far as it is known; nothing in a scene without a stage."""
    if not settings.overlays or ownership.find_stage(scene) is None:
        return
    try:
        wanted = {sketch.CAMERA: settings.cameras, sketch.PROJECTOR: settings.projectors, sketch.LASER: settings.projectors,
                  sketch.LIGHT: settings.lights, sketch.SHADOW: settings.lights}
        yield from (found for found in sketch.sketch_devices(scene) if wanted[found.kind])
        if settings.views:
            yield from sketch.sketch_views(scene, watching.watched.shots)
        if settings.turntable:
            yield sketch.sketch_turntable(scene, _stops())
        grid = watching.working_grid(scene) if settings.volume else None
        if grid is not None:
            yield from sketch.sketch_volume(scene, grid)
    except ScanstageError:
        return  # the turntable was deleted: the panel says so


def placed_labels(wanted: list[tuple[float, float, float, float]]) -> list[tuple[float, float]]:
    """Return where labels go so that none covers another: each at its place, or as little above it as is free.

    Parameters
    ----------
    wanted : list of (x, y, width, height)
        Lower left corners and sizes, in pixels; the first come first.
    """
    taken: list[tuple[float, float, float, float]] = []
    for x, y, width, height in wanted:
        beside = [box for box in taken if x < box[0] + box[2] and box[0] < x + width]
        for _, bottom, _, tall in sorted(beside, key=lambda box: box[1]):
            if y < bottom + tall and bottom < y + height:
                y = bottom + tall
        taken.append((x, y, width, height))
    return [(x, y) for x, y, _, _ in taken]


def _stops() -> np.ndarray:
    plan = watching.watched.plan
    poses = [] if plan is None else [frame.object_to_world for frame in plan.frames]
    return np.array(list({np.round(pose, 6).tobytes(): pose for pose in poses}.values())).reshape(-1, 4, 4)


def _draw_view() -> None:
    """Draw what lies in the space of the view."""
    context = bpy.context
    settings = context.window_manager.scanstage_view
    if not context.space_data.overlay.show_overlays or not watching.wanted() or ownership.find_stage(context.scene) is None:
        return
    _refresh(context.scene, settings)
    with _state(depth='LESS_EQUAL', blend='ALPHA'):
        _draw_surfaces(context, settings)
        for behind in (True, False):
            gpu.state.depth_test_set('GREATER' if behind else 'LESS_EQUAL')
            _draw_lines(context, _BEHIND if behind else 1.0)
        gpu.state.depth_test_set('LESS_EQUAL')
        _draw_pictures()
        shader = gpu.shader.from_builtin('UNIFORM_COLOR')
        for found, _, faces in _drawn.batches:
            if faces is not None:
                shader.uniform_float("color", (*COLORS[found.kind], _FACE_ALPHA * (1.0 if found.active else 0.4)))
                faces.draw(shader)


def _draw_lines(context: bpy.types.Context, share: float) -> None:
    shader = gpu.shader.from_builtin('POLYLINE_UNIFORM_COLOR')
    shader.uniform_float("viewportSize", (context.region.width, context.region.height))
    scale = context.preferences.system.ui_scale
    for found, lines, _ in _drawn.batches:
        if lines is not None:
            shader.uniform_float("lineWidth", _WIDTH[found.active] * scale)
            shader.uniform_float("color", (*COLORS[found.kind], _ALPHA[found.active] * share))
            lines.draw(shader)


def _draw_pictures() -> None:
    """Draw what the projectors show."""
    shader = gpu.shader.from_builtin('IMAGE_COLOR')
    for name, batch in _drawn.pictures:
        image = bpy.data.images.get(name)
        if image is not None and image.size[0]:
            shader.uniform_sampler("image", _texture_of(image))
            shader.uniform_float("color", (1.0, 1.0, 1.0, _PICTURE_ALPHA))
            batch.draw(shader)


def _texture_of(image: bpy.types.Image) -> gpu.types.GPUTexture:
    """Return an image for the graphics card; Blender's own is smaller in the distance, where the rows of patterns run into each other."""
    width, height = image.size
    if not ownership.is_marked(image) or width * height > _MOST_PIXELS:
        return gpu.texture.from_image(image)
    if image.session_uid not in _drawn.textures:  # patterns are made once and never rewritten
        pixels = np.zeros(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
        texture = gpu.types.GPUTexture((width, height), format='RGBA16F', data=gpu.types.Buffer('FLOAT', len(pixels), pixels))
        _drawn.textures = {image.session_uid: texture}
    return _drawn.textures[image.session_uid]


def _draw_surfaces(context: bpy.types.Context, settings: bpy.types.PropertyGroup) -> None:
    """Draw coverage and hull at the object's present pose."""
    shader = gpu.shader.from_builtin('SMOOTH_COLOR')
    try:
        pose = Matrix(readback.rigid_motion(readback.turntable_of(context.scene)).tolist())
    except ScanstageError:  # it was deleted just now
        return
    gpu.state.depth_mask_set(True)
    if _drawn.coverage is not None and settings.coverage != 'NONE':
        with _nearer(_ON_SURFACE, pose):
            _drawn.coverage.draw(shader)
    if _drawn.hull is not None and settings.live_hull:
        gpu.state.face_culling_set('BACK')
        with _nearer(_BEFORE_SURFACE, pose):
            _drawn.hull.draw(shader)
        gpu.state.face_culling_set('NONE')
    gpu.state.depth_mask_set(False)


def _draw_pixel() -> None:
    """Draw names and the legend."""
    context = bpy.context
    settings = context.window_manager.scanstage_view
    if not context.space_data.overlay.show_overlays or not watching.wanted() or ownership.find_stage(context.scene) is None:
        return
    with _state(depth='NONE', blend='ALPHA'):
        if settings.names:
            _draw_names(context)
        if _drawn.legend is not None and settings.coverage != 'NONE':
            _draw_legend(context, _drawn.legend)


def _draw_names(context: bpy.types.Context) -> None:
    scale, found = context.preferences.system.ui_scale, []
    blf.size(0, _TEXT * scale)
    for each in _drawn.sketches:
        at = location_3d_to_region_2d(context.region, context.region_data, each.anchor) if each.label and each.anchor is not None else None
        if at is not None:
            width, height = blf.dimensions(0, each.label)
            found.append((each, (at.x + 8 * scale, at.y + 4 * scale, width + 10 * scale, height + 8 * scale)))
    for (each, (_, _, width, height)), (x, y) in zip(found, placed_labels([box for _, box in found]), strict=True):
        _fill(x, y, width, height, _PLATE)
        blf.position(0, x + 5 * scale, y + 4 * scale, 0)
        blf.color(0, *COLORS[each.kind], 1.0 if each.active else 0.65)
        blf.draw(0, each.label)


def _draw_legend(context: bpy.types.Context, legend: Legend) -> None:
    """Draw the legend in the lower left corner, beside the toolbar."""
    scale = context.preferences.system.ui_scale
    edge, row, swatch, width = _EDGE * scale, _ROW * scale, _SWATCH * scale, _LEGEND_WIDTH * scale
    tools = next((region.width for region in context.area.regions if region.type == 'TOOLS'), 0)
    blf.size(0, _TEXT * scale)
    width = max(width, *(blf.dimensions(0, text)[0] + 2 * edge for text in (legend.title, legend.note)))
    x, y = tools + edge, edge
    height = (len(legend.entries) + 1.4 + bool(legend.note)) * row + edge / 2
    _fill(x, y, width, height, _PLATE)
    top = y + height - row
    blf.color(0, *_INK)
    blf.position(0, x + edge / 2, top, 0)
    blf.draw(0, legend.title)
    blf.size(0, _SMALL * scale)
    if legend.note:
        top -= row
        blf.position(0, x + edge / 2, top, 0)
        blf.draw(0, legend.note)
    for color, text in legend.entries:
        top -= row
        _fill(x + edge / 2, top - 0.2 * swatch, swatch * 1.6, swatch, (*color, 1.0))
        blf.position(0, x + edge / 2 + 2.2 * swatch, top, 0)
        blf.draw(0, text)


def _fill(x: float, y: float, width: float, height: float, color: tuple[float, float, float, float]) -> None:
    shader = gpu.shader.from_builtin('UNIFORM_COLOR')
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    shader.uniform_float("color", color)
    batch_for_shader(shader, 'TRI_FAN', {"pos": corners}).draw(shader)


def _refresh(scene: bpy.types.Scene, settings: bpy.types.PropertyGroup) -> None:
    """Make anew what has changed since it was drawn."""
    if _drawn.old or _drawn.version != watching.watched.version:
        _drawn.sketches = list(sketches_of(scene, settings))
        _drawn.batches = [(each, _batch('POLYLINE_UNIFORM_COLOR', 'LINES', each.lines), _batch('UNIFORM_COLOR', 'TRIS', each.faces))
                          for each in _drawn.sketches]
        _drawn.pictures = list(_picture_batches(scene, settings))
        _drawn.old, _drawn.version = False, watching.watched.version
    key = watching.watched.version, settings.coverage, settings.hull_opacity, settings.live_hull
    if _drawn.surface_key != key:
        _drawn.surface_key = key
        _drawn.coverage, _drawn.legend = _coverage_batch(scene, settings.coverage)
        _drawn.hull = _hull_batch(settings.hull_opacity) if settings.live_hull else None


def _picture_batches(scene: bpy.types.Scene, settings: bpy.types.PropertyGroup) -> Iterator[tuple[str, gpu.types.GPUBatch]]:
    if not (settings.overlays and settings.projectors):
        return
    shader = gpu.shader.from_builtin('IMAGE_COLOR')
    try:
        for found in projected_pictures(scene):
            content = {"pos": found.corners.reshape(-1, 3).astype(np.float32), "texCoord": found.places.reshape(-1, 2).astype(np.float32)}
            yield found.image.name, batch_for_shader(shader, 'TRIS', content)
    except ScanstageError:
        return  # the turntable was deleted: the panel says so


def _coverage_batch(scene: bpy.types.Scene, shown: str) -> tuple[gpu.types.GPUBatch | None, Legend | None]:
    found = watching.watched.coverage
    if found is None or shown == 'NONE':
        return None, None
    surveyor = watching.watched.surveyor
    colors, legend = colors_of(found, shown, partial(length_text, scene))
    return _batch('SMOOTH_COLOR', 'TRIS', surveyor.corners, np.repeat(shaded(colors, surveyor.normals), 3, axis=0), 1.0), legend


def _hull_batch(opacity: float) -> gpu.types.GPUBatch | None:
    found = watching.watched.hull
    if found is None or not len(found.quads):
        return None
    normals = found.normals(smoothing=2)[found.face_voxel]
    colors = shaded(np.broadcast_to(HULL, (len(normals), 3)), normals)
    return _batch('SMOOTH_COLOR', 'TRIS', found.vertices[found.triangles()], np.repeat(colors, 6, axis=0), opacity)


def _batch(shader: str, kind: str, points: np.ndarray, colors: np.ndarray | None = None, alpha: float = 1.0) -> gpu.types.GPUBatch | None:
    if not points.size:
        return None
    content = {"pos": np.ascontiguousarray(points.reshape(-1, 3), np.float32)}
    if colors is not None:
        content["color"] = np.column_stack((colors, np.full(len(colors), alpha))).astype(np.float32)
    return batch_for_shader(gpu.shader.from_builtin(shader), kind, content)


@contextmanager
def _nearer(share: float, pose: Matrix) -> Iterator[None]:
    """Draw what stands at ``pose`` at a share of its distance from the eye: at the same place of the picture, before what is there."""
    with gpu.matrix.push_pop():
        gpu.matrix.load_matrix(Matrix.Diagonal((share, share, share, 1.0)) @ gpu.matrix.get_model_view_matrix() @ pose)
        yield


@contextmanager
def _state(*, depth: str, blend: str) -> Iterator[None]:
    gpu.state.depth_test_set(depth)
    gpu.state.blend_set(blend)
    try:
        yield
    finally:
        gpu.state.depth_test_set('NONE')
        gpu.state.depth_mask_set(False)
        gpu.state.blend_set('NONE')


@persistent
def draw_anew(*_) -> None:
    """Have the rig read again before it is next drawn."""
    _drawn.old = True


def register() -> None:
    """Begin to draw. Without a window there is nothing to draw in."""
    if bpy.app.background:
        return
    for handlers in (bpy.app.handlers.depsgraph_update_post, bpy.app.handlers.frame_change_post, bpy.app.handlers.load_post):
        handlers.append(draw_anew)
    _drawn.handles = [bpy.types.SpaceView3D.draw_handler_add(draw, (), 'WINDOW', event)
                      for draw, event in ((_draw_view, 'POST_VIEW'), (_draw_pixel, 'POST_PIXEL'))]


def unregister() -> None:
    """Draw no more, and free what lies on the graphics card."""
    if bpy.app.background:
        return
    for handle in _drawn.handles:
        bpy.types.SpaceView3D.draw_handler_remove(handle, 'WINDOW')
    for handlers in (bpy.app.handlers.depsgraph_update_post, bpy.app.handlers.frame_change_post, bpy.app.handlers.load_post):
        handlers.remove(draw_anew)
    _drawn.__init__()
