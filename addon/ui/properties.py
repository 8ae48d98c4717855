# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene remembers of the work, and what the running job tells the panels.

The options of presets, methods, silhouettes and shadows are made from the tables that also feed the command line: a new option
there is a new field in the panel, with its tooltip, unit, bounds and default.
"""

from __future__ import annotations

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..captures.importers import IMPORTERS
from ..options import Option, Unit, Value
from ..reconstruction.methods import DEFAULT_VOXELS, METHODS
from ..reconstruction.shadows import SHADOW_OPTIONS
from ..reconstruction.silhouettes import SILHOUETTE_OPTIONS
from ..stage.carried import scannable
from ..stage.objects import BUILTINS
from ..stage.presets import PRESETS
from .probability import show_again

_FLOAT_UNITS = {Unit.LENGTH: {"unit": 'LENGTH'}, Unit.ANGLE: {"subtype": 'ANGLE'}, Unit.MILLIMETRES: {"unit": 'CAMERA'}}
_LARGEST_INT = 2 ** 31 - 1


def field_name(prefix: str, name: str) -> str:
    """Return the attribute that holds the options of a preset or method: ``method_visual_hull``."""
    return f"{prefix}_{name.replace('-', '_')}"


def values_of(group: bpy.types.PropertyGroup, options: tuple[Option, ...]) -> dict[str, Value]:
    """Return what the user set, as the functions take it."""
    return {option.name: getattr(group, option.name) for option in options}


def changed_values(group: bpy.types.PropertyGroup, options: tuple[Option, ...]) -> dict[str, Value]:
    """Return the options that the user set: what was left alone stays as the capture set, or the function, has it."""
    return {name: value for name, value in values_of(group, options).items() if group.is_property_set(name)}


def _property(option: Option):
    """Return the Blender property for an option."""
    words = {"name": option.label, "description": option.description, "default": option.default}
    if option.choices:
        return EnumProperty(items=[(name, name.replace("_", " ").capitalize(), text) for name, text in option.choices.items()], **words)
    if isinstance(option.default, bool):
        return BoolProperty(**words)
    if isinstance(option.default, int):
        return IntProperty(min=int(max(option.minimum, -_LARGEST_INT)), max=int(min(option.maximum, _LARGEST_INT)),
                           subtype='PIXEL' if option.unit is Unit.PIXELS else 'NONE', **words)
    if isinstance(option.default, float):
        return FloatProperty(min=max(option.minimum, -3e38), max=min(option.maximum, 3e38), precision=3,
                             **_FLOAT_UNITS.get(option.unit, {}), **words)
    return StringProperty(**words)


def _group(name: str, options: tuple[Option, ...]) -> type[bpy.types.PropertyGroup]:
    """Return a property group class with a field for every option."""
    fields = {option.name: _property(option) for option in options}
    return type(f"SCANSTAGE_PG_{name}", (bpy.types.PropertyGroup,), {"__annotations__": fields})


def _items(table) -> list[tuple[str, str, str]]:
    return [(name, entry.label, entry.description) for name, entry in table.items()]


_SILHOUETTES = _group("silhouettes", SILHOUETTE_OPTIONS)
_SHADOWS = _group("shadows", SHADOW_OPTIONS)
_PRESET_GROUPS = {field_name("preset", name): _group(field_name("preset", name), preset.options) for name, preset in PRESETS.items()}
_METHOD_GROUPS = {field_name("method", name): _group(field_name("method", name), method.options) for name, method in METHODS.items()}


def _settings_fields() -> dict:
    """Return the fields of `Scene.scanstage`."""
    fields = {
        "preset": EnumProperty(name="Rig", description="The rig to build", items=_items(PRESETS)),
        "source": EnumProperty(name="Object", description="What stands on the turntable", items=[
            ('BUILTIN', "Example", "One of the objects that come with Scanstage"),
            ('SCENE', "From Scene", "An object of this scene, used as it is"),
            ('SELECTION', "Selected", "All objects that are selected, together, each used as it is"),
            ('FILE', "From File", "A mesh file, in its own units")]),
        "builtin": EnumProperty(name="Example", description="An object that comes with Scanstage", items=[
            (name, name.replace("-", " ").title(), entry.description) for name, entry in BUILTINS.items()]),
        "subject": PointerProperty(name="Object", description="The object of this scene to scan", type=bpy.types.Object,
                                   poll=lambda settings, candidate: bool(scannable([candidate]))),
        "file": StringProperty(name="File", description="A mesh: .ply .obj .stl .glb .fbx .blend", subtype='FILE_PATH'),
        "capture_folder": StringProperty(name="Captures", subtype='DIR_PATH',
                                         description="Folder of the capture set. Empty: scanstage/capture beside this file, or in "
                                         "Blender's temporary folder, which goes with Blender, while the file is not saved"),
        "capture_state": StringProperty(description="What the last capture or import left"),
        "capture_frames": IntProperty(description="Captured frames"),
        "capture_pixels": FloatProperty(description="Pixels of all captured frames together"),
        "frame_seconds": FloatProperty(description="How long a frame of the last capture took"),
        "import_format": EnumProperty(name="Format", description="How the captures were calibrated", items=_items(IMPORTERS)),
        "method": EnumProperty(name="Method", description="How to reconstruct", items=_items(METHODS)),
        "voxels": IntProperty(name="Voxels", description="Along the longest side of the working volume; time and memory grow with "
                              "the square", default=DEFAULT_VOXELS, min=8, soft_max=1024, max=16384),
        "use_bounds": BoolProperty(name="Set Working Volume", description="Give the working volume instead of finding it from the views"),
        "bounds_lower": FloatVectorProperty(name="Lower", description="Lower corner of the working volume, from the turntable's "
                                            "centre", unit='LENGTH', default=(-0.15, -0.15, 0.0)),
        "bounds_upper": FloatVectorProperty(name="Upper", description="Upper corner of the working volume", unit='LENGTH',
                                            default=(0.15, 0.15, 0.3)),
        "result_folder": StringProperty(name="Result", subtype='DIR_PATH',
                                        description="Folder of the result. Empty: scanstage/result beside this file, or in "
                                        "Blender's temporary folder, which goes with Blender, while the file is not saved"),
        "smooth": BoolProperty(name="Smooth", description="Take off the voxels' steps with a live modifier"),
        "least_probability": FloatProperty(name="Least Probability", description="Show the voxels that are more probable; nothing is "
                                           "computed again", min=0.0, max=1.0, default=0.5, subtype='FACTOR', update=show_again),
        "probability_colors": BoolProperty(name="Colour by Probability", description="Colour the voxels by their probability, and not "
                                           "as the pictures show them", default=True, update=show_again),
        "result_lines": StringProperty(description="What the last reconstruction found, one fact a line"),
        "calibration_lines": StringProperty(description="What the last calibration found, one fact a line"),
        "measures": StringProperty(description="The last comparison with the truth, as JSON"),
        "silhouettes": PointerProperty(type=_SILHOUETTES),
        "shadows": PointerProperty(type=_SHADOWS),
    }
    fields |= {name: PointerProperty(type=group) for name, group in (_PRESET_GROUPS | _METHOD_GROUPS).items()}
    return fields


class SCANSTAGE_PG_job(bpy.types.PropertyGroup):
    """The job that runs, for the panels to show."""

    running: BoolProperty()
    stop: BoolProperty()
    operator: StringProperty()
    fraction: FloatProperty(min=0.0, max=1.0)
    message: StringProperty()


SCANSTAGE_PG_settings = type("SCANSTAGE_PG_settings", (bpy.types.PropertyGroup,), {
    "__annotations__": _settings_fields(), "__doc__": "Everything that the panels set."})

CLASSES = (_SILHOUETTES, _SHADOWS, *_PRESET_GROUPS.values(), *_METHOD_GROUPS.values(), SCANSTAGE_PG_job, SCANSTAGE_PG_settings)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the groups and attach them."""
    _register_classes()
    bpy.types.Scene.scanstage = PointerProperty(type=SCANSTAGE_PG_settings)
    bpy.types.WindowManager.scanstage_job = PointerProperty(type=SCANSTAGE_PG_job)


def unregister() -> None:
    """Detach and unregister the groups."""
    del bpy.types.WindowManager.scanstage_job
    del bpy.types.Scene.scanstage
    _unregister_classes()
