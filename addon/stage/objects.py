# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What can stand on a turntable: built-in objects, the user's own objects, and files.

A built-in object or a file becomes the stage's. Objects of the user's stay where they are, untouched but for one
constraint: the turntable is put under them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

# isort: split
import bmesh  # exists once bpy is imported
import numpy as np

from ..errors import ScanstageError
from . import ownership
from .carried import carry
from .evaluated import render_mesh
from .materials import Texture, textured
from .units import metres_of

BUILTIN_SIZE = 0.2  # metres, the largest dimension of every built-in object
_PLAINEST = "dented-sphere"  # whose texture other objects are given where they need one


@dataclass(frozen=True)
class Builtin:
    """A built-in object.

    Parameters
    ----------
    label, description : str
        As a panel shows it: a title, and what it is good for, without a full stop.
    texture : Texture
    """

    label: str
    description: str
    texture: Texture


BUILTINS: Mapping[str, Builtin] = {
    "monkey": Builtin("Monkey", "Suzanne: ears, brows and a chin, mostly convex", Texture(
        ((0.12, 0.30, 0.34), (0.34, 0.50, 0.30), (0.74, 0.52, 0.20), (0.70, 0.30, 0.12), (0.40, 0.12, 0.16)), 20, 90)),
    "dented-sphere": Builtin("Dented Sphere", "A sphere with three dents, which no silhouette shows", Texture(
        ((0.08, 0.22, 0.45), (0.12, 0.50, 0.55), (0.70, 0.66, 0.30), (0.72, 0.30, 0.16), (0.42, 0.10, 0.22)), 18, 80)),
    "pot": Builtin("Pot", "A pot with a pit two thirds as deep as it is wide", Texture(
        ((0.50, 0.16, 0.08), (0.68, 0.32, 0.14), (0.74, 0.56, 0.34), (0.20, 0.36, 0.42)), 22, 95, bands=0.55)),
    "knot": Builtin("Knot", "A trefoil knot: holes, and parts that hide each other", Texture(
        ((0.55, 0.10, 0.18), (0.72, 0.34, 0.20), (0.70, 0.62, 0.24), (0.16, 0.46, 0.30), (0.12, 0.24, 0.52)), 14, 85)),
    "figure": Builtin("Figure", "A standing figure with thin arms, legs and a staff", Texture(
        ((0.12, 0.30, 0.20), (0.34, 0.52, 0.20), (0.72, 0.58, 0.26), (0.62, 0.24, 0.12), (0.28, 0.12, 0.30)), 24, 110)),
}

# By file ending. The axes are those that each format's convention says, which Blender's importers know.
IMPORTERS: Mapping[str, Callable[[str], object]] = {
    ".ply": lambda path: bpy.ops.wm.ply_import(filepath=path),
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    ".stl": lambda path: bpy.ops.wm.stl_import(filepath=path),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),
    ".blend": lambda path: _append_objects(path),
}


@dataclass(frozen=True)
class Subject:
    """What is to be staged, found but not yet touched. One of the three is given.

    Parameters
    ----------
    builtin : str, optional
        A name of `BUILTINS`.
    existing : tuple of bpy.types.Object
        Objects of the user's in the scene.
    path : Path, optional
        A file.
    """

    builtin: str | None = None
    existing: tuple[bpy.types.Object, ...] = ()
    path: Path | None = None


def find_subject(scene: bpy.types.Scene, subject: str | Path | bpy.types.Object | Sequence[bpy.types.Object]) -> Subject:
    """Find what the user means: the name of a built-in object, of an object in the scene, a file, an object or several.

    Raises
    ------
    ScanstageError
        There is no such object or file, or the file's ending is not known.
    """
    if isinstance(subject, bpy.types.Object):
        return Subject(existing=(subject,))
    if not isinstance(subject, (str, Path)):
        return Subject(existing=tuple(subject))
    if not isinstance(subject, Path):
        if subject in BUILTINS:
            return Subject(builtin=subject)
        existing = scene.objects.get(subject)
        if existing is not None and not ownership.is_marked(existing):
            return Subject(existing=(existing,))
    path = Path(bpy.path.abspath(str(subject)))
    known = ", ".join(IMPORTERS)
    if path.suffix.lower() not in IMPORTERS:
        if path.suffix and path.exists():
            raise ScanstageError(f"{path}: files ending with {path.suffix!r} cannot be staged; use one of {known}")
        raise ScanstageError(f"object {str(subject)!r} is neither built in ({', '.join(BUILTINS)}) nor in scene "
                             f"{scene.name!r} nor a file ending with one of {known}")
    if not path.is_file():
        raise ScanstageError(f"{path}: there is no such file; check the path")
    return Subject(path=path)


def add_object(scene: bpy.types.Scene, stage: bpy.types.Collection, turntable: bpy.types.Object, subject: Subject, *,
               fit: float = 0.0) -> np.ndarray:
    """Stand an object on the turntable: its lowest point at z = 0 of the table, its middle on the axis.

    Parameters
    ----------
    scene : bpy.types.Scene
    stage : bpy.types.Collection
        The stage's collection, into which new objects go.
    turntable : bpy.types.Object
        At the world's origin; moved under an object that exists already.
    subject : Subject
    fit : float
        Scale a built-in object or file so that its largest dimension is this; 0 keeps a file's own units, and makes a built-in
        object as large as it is in metres.

    Returns
    -------
    (n, 3) array
        The object's vertices in the object frame, as renders see them.

    Raises
    ------
    ScanstageError
        The file cannot be read or holds no mesh, or the object has no faces.
    """
    if subject.existing:
        return _put_under(scene, turntable, subject.existing, fit)
    roots = [_add_builtin(stage, subject.builtin)] if subject.builtin else _import(stage, subject.path)
    carrier = ownership.add(stage, "Scanstage Object", None, "object")
    carrier.parent, carrier.empty_display_size = turntable, 0.01
    for root in roots:
        root.parent = carrier
    members = [o for root in roots for o in (root, *root.children_recursive)]
    vertices = _vertices(scene, members, subject.builtin or str(subject.path))
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    scale = fit / max((upper - lower).max(), 1e-30) if fit else 1 / metres_of(scene) if subject.builtin else 1.0
    base = np.append((lower[:2] + upper[:2]) / 2, lower[2])
    carrier.scale, carrier.location = (scale,) * 3, -base * scale
    return (vertices - base) * scale


def texture_for(subject: Subject, size: float) -> Texture:
    """Return a texture for an object whose largest dimension is ``size`` metres: a built-in object's own, or one that suits any."""
    texture = BUILTINS[subject.builtin or _PLAINEST].texture
    return replace(texture, patches=texture.patches * BUILTIN_SIZE / size, grain=texture.grain * BUILTIN_SIZE / size)


def assets_folder() -> Path:
    """Return the folder of the built-in assets: in the package's root once installed, beside ``addon/`` in a clone."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "assets"
    return installed if installed.is_dir() else package.parent / "assets"


def monkey_mesh(name: str) -> bpy.types.Mesh:
    """Return Suzanne as one closed surface, `BUILTIN_SIZE` large; the original is open, with loose eyes."""
    rough = bpy.data.meshes.new(name)
    cage = bmesh.new()
    bmesh.ops.create_monkey(cage)
    cage.to_mesh(rough)
    cage.free()
    helper = bpy.data.objects.new(name, rough)
    helper.modifiers.new("Smooth", "SUBSURF").levels = 2
    remesh = helper.modifiers.new("Close", "REMESH")
    remesh.mode, remesh.voxel_size = "VOXEL", 0.02
    mesh = evaluated_copy(helper)
    bpy.data.objects.remove(helper)
    bpy.data.meshes.remove(rough)
    mesh.name = name
    resize(mesh, BUILTIN_SIZE)
    return mesh


def evaluated_copy(helper: bpy.types.Object) -> bpy.types.Mesh:
    """Return a new mesh: an object's with its modifiers applied. The object need not be in a scene."""
    scene = bpy.context.scene
    scene.collection.objects.link(helper)
    try:
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return bpy.data.meshes.new_from_object(helper.evaluated_get(depsgraph))
    finally:
        scene.collection.objects.unlink(helper)


def resize(mesh: bpy.types.Mesh, size: float) -> None:
    """Scale a mesh so that its largest dimension is ``size``, and put the middle of its base at the origin."""
    points = np.zeros(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", points)
    points = points.reshape(-1, 3).astype(np.float64)
    lower, upper = points.min(axis=0), points.max(axis=0)
    base = np.append((lower[:2] + upper[:2]) / 2, lower[2])
    points = (points - base) * (size / (upper - lower).max())
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    mesh.update()


def _add_builtin(stage: bpy.types.Collection, name: str) -> bpy.types.Object:
    if name == "monkey":
        root = bpy.data.objects.new(name, monkey_mesh(name))
        ownership.mark(root)
        ownership.mark(root.data)
        stage.objects.link(root)
    else:
        root, = _import(stage, assets_folder() / "objects" / f"{name}.ply")
        root.name = root.data.name = name
    root.data.shade_smooth()
    root.data.materials.clear()
    root.data.materials.append(textured(f"Scanstage {name}", BUILTINS[name].texture))
    return root


def _import(stage: bpy.types.Collection, path: Path) -> list[bpy.types.Object]:
    """Import a file into the stage; return its top-level objects."""
    before = {o.session_uid for o in bpy.data.objects}
    layer = bpy.context.view_layer
    active, selected = layer.objects.active, list(bpy.context.selected_objects)
    with ownership.marking_new():
        try:
            IMPORTERS[path.suffix.lower()](str(path))
        except (RuntimeError, AttributeError, OSError) as error:  # how operators and libraries report a bad file
            raise ScanstageError(f"{path}: Blender cannot read this file ({_first_line(error)}); "
                                 "export it again") from None
    new = [o for o in bpy.data.objects if o.session_uid not in before]
    for made in new:
        for collection in made.users_collection:
            collection.objects.unlink(made)
        stage.objects.link(made)
    for extra in [o for o in new if o.type in {"CAMERA", "LIGHT"}]:
        new.remove(extra)
        bpy.data.objects.remove(extra)
    layer.objects.active = active
    for other in layer.objects:
        other.select_set(other in selected)
    if not any(o.type in {"MESH", "CURVE", "SURFACE", "FONT", "META"} or o.instance_collection for o in new):
        raise ScanstageError(f"{path}: holds no mesh; export the object's surface")
    return [o for o in new if o.parent is None]


def _append_objects(path: str) -> None:
    with bpy.data.libraries.load(path, link=False) as (source, target):
        target.objects = list(source.objects)


def _first_line(error: Exception) -> str:
    return next(iter(str(error).removeprefix("Error: ").strip().splitlines()), type(error).__name__).rstrip(".")


def _put_under(scene: bpy.types.Scene, turntable: bpy.types.Object, existing: Sequence[bpy.types.Object], fit: float) -> np.ndarray:
    name = f"object {existing[0].name!r}" if len(existing) == 1 else f"{existing[0].name!r} and {len(existing) - 1} more objects"
    if fit:
        raise ScanstageError(f"option fit: {name} is in the scene already and is staged at its own "
                             "size; leave fit at 0, or scale the object")
    members = {member: None for root in existing for member in (root, *root.children_recursive)}
    vertices = _vertices(scene, list(members), name)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    turntable.location = (*(lower[:2] + upper[:2]) / 2, lower[2])
    carry(existing, turntable)
    return vertices - np.array(turntable.location)


def _vertices(scene: bpy.types.Scene, members: list[bpy.types.Object], source: str) -> np.ndarray:
    vertices, triangles = render_mesh(scene, members)
    if not len(triangles):
        raise ScanstageError(f"{source}: has no faces that are rendered; stage an object with a surface")
    return vertices[np.unique(triangles)]
