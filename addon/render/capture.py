# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Plays the plan on the timeline into a capture set: resumable, interruptible, never half-written.

`capture.json` is there before the first picture, with every planned frame and with all of them missing, so that a
capture that was cut short says what it lacks. A picture that is on disk and whole is not rendered again, whoever
rendered it: a render farm that was given the .blend writes the same names.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ..captures.pictures import picture_header
from ..captures.schema import Capture, Frame
from ..captures.store import is_capture, picture_is_whole, read_capture, write_capture
from ..errors import ScanstageError
from ..results.ply import read_ply, write_ply
from ..stage import ownership
from ..stage.fingerprint import NOTE, fingerprint
from ..stage.readback import CapturePlan, PlannedFrame, camera_of, plan_of, rigid_motion, staged_objects, truth_mesh, turntable_of
from .farm import FarmFrames
from .settings import capture_settings, hidden

TRUTH = "truth.ply"
Renderer = Callable[[Sequence["Shot"], str], Generator[str | None, None, None]]
_SAME = 1e-6  # metres, pixels and matrix elements: what a plan may differ by and be the same


@dataclass(frozen=True)
class Shot:
    """One frame that is to be rendered.

    Parameters
    ----------
    id : str
        In the capture set.
    number : int
        Of the timeline.
    path : Path
        Where its picture is to be.
    size : (int, int)
        Of the picture.
    """

    id: str
    number: int
    path: Path
    size: tuple[int, int]


def capture_frames(scene: bpy.types.Scene, folder: str | Path, *, resume: bool = True,
                   most: int | None = None, farm: FarmFrames | None = None,
                   renderer: Renderer | None = None) -> Iterator[tuple[float, str]]:
    """Render the scene's plan into a capture set, one picture a step.

    Parameters
    ----------
    scene : bpy.types.Scene
        With a stage.
    folder : path-like
        Made if there is none.
    resume : bool
        Whether whole pictures that are there are kept. A set of another plan is then refused; without it, overwritten.
    most : int, optional
        How many frames are rendered; all that are missing otherwise. The set lists those that it then still lacks.
    farm : FarmFrames, optional
        Where frames are that were rendered elsewhere: what of them can be used is taken before anything is rendered.
    renderer : callable, optional
        Does what `render_frames` does with the missing frames, elsewhere. Clean plates are rendered here all the same.

    Yields
    ------
    (float, str)
        The fraction that is done, and a message for a person. Closing the generator in between restores the scene and
        leaves a set that lists the frames it lacks.

    Raises
    ------
    ScanstageError
        The scene has no stage, the folder holds a capture of something else or cannot be written, a render fails, or the
        scene carries no fingerprint by which a farm's frames could be told.
    """
    folder = Path(folder)
    plan = plan_of(scene)
    truth = truth_mesh(scene) if plan.board is None else None
    planned, note = _capture(scene, plan), fingerprint(plan, truth)
    if farm is not None:
        _check_stamped(scene, farm, note)
    if resume:
        _check_same(folder, planned, truth)
    _make_folders(folder, planned)
    if truth is not None:
        write_ply(folder / TRUTH, *truth, double=True)
    sizes = {frame.id: plan.cameras[frame.camera].size for frame in plan.frames}
    known = _rendered(folder) if resume else set()
    missing = [frame.id for frame in planned.frames if not (
        resume and _is_there(folder / frame.image, sizes[frame.id], note, known=frame.id in known))]
    _write(folder, planned, missing)
    try:
        if farm is not None:
            yield from _take_frames(farm, folder, plan, planned, missing, note)
        with capture_settings(scene, note):
            yield from _render_plates(scene, folder, plan, planned, resume)
        shots, frames = _shots(folder, plan, planned, missing[:most]), {frame.number: frame for frame in plan.frames}
        here = partial(render_frames, scene, check=partial(_check_unmoved, scene, plan, frames))
        with closing((renderer or here)(shots, note)) as done:
            yield from _counted(done, len(planned.frames), missing)
    finally:
        _write(folder, planned, missing)
    whole = len(planned.frames) - len(missing)
    yield whole / len(planned.frames), f"{whole} frames in {folder}"


def _capture(scene: bpy.types.Scene, plan: CapturePlan) -> Capture:
    options = ownership.staged_options(ownership.require_stage(scene))
    with_plates = options.get("plate", False) and options.get("backdrop", "none") != "none"
    return Capture(
        cameras=plan.cameras,
        lights=plan.lights,
        frames=tuple(Frame(frame.id, f"images/{frame.id}.png", frame.camera, frame.object_to_world, frame.lights,
                           frame.pattern, board_pose=frame.board_pose) for frame in plan.frames),
        projectors=plan.projectors,
        patterns=plan.patterns,
        encoding="linear",
        silhouette={"silhouette": _silhouette(options.get("backdrop", "none"), with_plates)},
        plates={id: f"plates/{id}.png" for id in plan.cameras} if with_plates else {},
        truth_mesh=TRUTH if plan.board is None else None,
        board=plan.board)


def _silhouette(backdrop: str, with_plates: bool) -> str:
    """Return the extractor of `addon.reconstruction.silhouettes` that fits what is behind the object."""
    if backdrop == "black":
        return "plate" if with_plates else "threshold"
    return "chroma" if backdrop == "blue" else "alpha"


def _rendered(folder: Path) -> set[str]:
    """Return the ids of the frames that a set says it has."""
    if not is_capture(folder):
        return set()
    found = read_capture(folder, require_pictures=False)
    return {frame.id for frame in found.frames}.difference(found.missing)


def _is_there(path: Path, size: tuple[int, int], note: str, *, known: bool) -> bool:
    """Return whether a frame need not be rendered: its picture is whole, and not of another plan, as far as it or the set says."""
    header = picture_header(path)
    return header is not None and header.fits(size) and (known or header.texts.get(NOTE, note) == note)


def _check_stamped(scene: bpy.types.Scene, farm: FarmFrames, note: str) -> None:
    if scene.render.stamp_note_text != note:
        raise ScanstageError(f"scene {scene.name!r}: its plan has changed since it was saved with a fingerprint, or never had one, so the "
                             f"frames in {farm.folder} cannot be told from those of another plan; stage it again, or save it with the "
                             "extension enabled, and let the farm render that file")


def _take_frames(farm: FarmFrames, folder: Path, plan: CapturePlan, planned: Capture, missing: list[str],
                 note: str) -> Iterator[tuple[float, str]]:
    """Copy what a farm has rendered of the missing frames, and take each out of ``missing``."""
    total, wanted = len(planned.frames), set(missing)
    for frame, entry in zip(plan.frames, planned.frames, strict=True):
        if entry.id in wanted and farm.take(frame.number, folder / entry.image, plan.cameras[frame.camera].size, note):
            missing.remove(entry.id)
            yield (total - len(missing)) / total, f"taking frame {entry.id} from {farm.folder}"


def _write(folder: Path, planned: Capture, missing: list[str]) -> None:
    """Write `capture.json` with what is on disk by now."""
    plates = {camera: image for camera, image in planned.plates.items() if (folder / image).is_file()}
    write_capture(folder, replace(planned, missing=tuple(missing), plates=plates))


def render_frames(scene: bpy.types.Scene, shots: Sequence[Shot], note: str, check: Callable[[Shot], None] | None = None) -> Iterator[str]:
    """Render shots with the capture settings; yield the id of each whose picture is on disk.

    ``note`` goes into each file. ``check`` is asked at the frame of each shot whether the scene is still the planned one.
    """
    with capture_settings(scene, note):
        for shot in shots:
            scene.frame_set(shot.number)
            if check:
                check(shot)
            _render(scene, shot.path, shot.size)
            yield shot.id


def _shots(folder: Path, plan: CapturePlan, planned: Capture, wanted: Collection[str]) -> list[Shot]:
    wanted = set(wanted)
    return [Shot(entry.id, frame.number, folder / entry.image, plan.cameras[frame.camera].size)
            for frame, entry in zip(plan.frames, planned.frames, strict=True) if entry.id in wanted]


def _counted(done: Iterator[str | None], total: int, missing: list[str]) -> Iterator[tuple[float, str]]:
    """Take each frame that is done out of ``missing``, and say how far it is."""
    message = f"{total - len(missing)} of {total} frames are there already" if len(missing) < total else "Waiting for the first frame"
    if len(missing) < total:
        yield (total - len(missing)) / total, message
    for id in done:
        if id is not None:
            missing.remove(id)
            message = f"frame {id}, {total - len(missing)} of {total}"
        yield (total - len(missing)) / total, message


def _check_unmoved(scene: bpy.types.Scene, plan: CapturePlan, frames: Mapping[int, PlannedFrame], shot: Shot) -> None:
    """Refuse to render what the plan no longer describes: in a window, the rig can be moved while it is captured."""
    frame = frames[shot.number]
    planned, there = plan.cameras[frame.camera], scene.camera and camera_of(scene, scene.camera)
    if there is None or not all(_close(getattr(there, name), getattr(planned, name)) for name in ("K", "R", "t")) \
            or not _close(rigid_motion(turntable_of(scene)), frame.object_to_world):
        raise ScanstageError(f"frame {frame.number} of scene {scene.name!r}: the rig was moved while it was captured; put it back, "
                             "or capture into an empty folder")


def _render_plates(scene: bpy.types.Scene, folder: Path, plan: CapturePlan, planned: Capture,
                   resume: bool) -> Iterator[tuple[float, str]]:
    for camera, image in planned.plates.items():
        size = plan.cameras[camera].size
        if resume and picture_is_whole(folder / image, size):
            continue
        number = next(frame.number for frame in plan.frames if frame.camera == camera)
        scene.frame_set(number)
        with hidden(staged_objects(scene)):
            _render(scene, folder / image, size)
        yield 0.0, f"clean plate of {camera}"


def _render(scene: bpy.types.Scene, path: Path, size: tuple[int, int]) -> None:
    """Render the present frame of the timeline to a temporary name in the same folder, then give it its own."""
    temporary = path.with_name(f".{path.stem}.part.png")
    scene.render.filepath = str(temporary.with_suffix(""))  # Blender adds the ending
    try:
        bpy.ops.render.render(write_still=True, scene=scene.name)
        if not picture_is_whole(temporary, size):
            raise ScanstageError(f"{path}: Blender did not write this picture whole; check the disk space")
        os.replace(temporary, path)
    except (RuntimeError, OSError) as error:
        raise ScanstageError(f"{path}: cannot be rendered ({str(error).strip()}); check the disk space and the rights "
                             f"of {path.parent}") from None
    finally:
        temporary.unlink(missing_ok=True)


def _make_folders(folder: Path, planned: Capture) -> None:
    try:
        for path in {folder, *((folder / frame.image).parent for frame in planned.frames),
                     *((folder / plate).parent for plate in planned.plates.values())}:
            path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScanstageError(f"{folder}: cannot be made a folder ({error.strerror}); choose another") from None


def _check_same(folder: Path, planned: Capture, truth: tuple[np.ndarray, np.ndarray] | None) -> None:
    """Refuse to mix two captures in one folder."""
    if not is_capture(folder):
        return
    found = read_capture(folder, require_pictures=False)
    difference = _difference(found, planned)
    if difference is None and truth is not None and (folder / TRUTH).is_file():
        known = read_ply(folder / TRUTH)
        difference = None if _close(known.vertices, truth[0]) and np.array_equal(known.triangles, truth[1]) \
            else "another object"
    if difference is not None:
        raise ScanstageError(f"{folder}: holds a capture of another plan ({difference}); choose an empty folder, or "
                             "remove this one")


def _difference(found: Capture, planned: Capture) -> str | None:
    """Return how two plans differ, in words for the user, or None if they are the same."""
    if [frame.id for frame in found.frames] != [frame.id for frame in planned.frames]:
        return f"{len(found.frames)} frames instead of {len(planned.frames)}"
    if found.board != planned.board:
        return "another calibration board"
    for kind in ("cameras", "lights", "projectors", "patterns"):
        if set(getattr(found, kind)) != set(getattr(planned, kind)):
            return f"other {kind}"
    for id, device in (*planned.cameras.items(), *planned.projectors.items()):
        known = found.cameras[id] if id in planned.cameras else found.projectors[id]
        if known.size != device.size:
            return "another resolution"
        if not all(_close(getattr(known, name), getattr(device, name)) for name in ("K", "R", "t", "distortion")):
            return f"{id} elsewhere"
    for id, pattern in planned.patterns.items():
        if not _same_pattern(found.patterns[id], pattern):
            return f"another pattern {id}"
    for id, light in planned.lights.items():
        if found.lights[id].kind != light.kind or not _close(found.lights[id].position, light.position):
            return f"{id} elsewhere"
    for mine, theirs in zip(planned.frames, found.frames, strict=True):
        if replace(mine, object_to_world=None) != replace(theirs, object_to_world=None):
            return f"frame {mine.id} with another camera, light, pattern or pose of the board"
        if not _close(mine.object_to_world, theirs.object_to_world):
            return f"frame {mine.id} at another pose"
    return None


def _same_pattern(found: Mapping[str, object], planned: Mapping[str, object]) -> bool:
    """Return whether two patterns have the same fields; a laser's plane, a measured thing, may differ by rounding."""
    plain = [{name: value for name, value in pattern.items() if name != "plane"} for pattern in (found, planned)]
    return plain[0] == plain[1] and _close(*(np.asarray(pattern.get("plane", ()), float) for pattern in (found, planned)))


def _close(a: np.ndarray, b: np.ndarray) -> bool:
    return np.shape(a) == np.shape(b) and bool(np.allclose(a, b, rtol=_SAME, atol=_SAME))
