# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every difference between Blender 4.5 and 5.x that the add-on meets, found by feature and not by version number."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import bpy


def node_tree(datablock: bpy.types.ID) -> bpy.types.NodeTree:
    """Return the shader node tree of a material, world or light, made if need be.

    5.x makes the tree with the data-block and deprecates ``use_nodes``; 4.5 makes it when that is switched on.
    """
    if datablock.node_tree is None:
        datablock.use_nodes = True
    return datablock.node_tree


def set_value(owner: bpy.types.bpy_struct, name: str, value: object) -> None:
    """Set a render or view setting, with what has to be set before it.

    5.x sorts image formats into media types and refuses a format of another type than the current one.
    """
    if name == "file_format" and hasattr(owner, "media_type"):
        owner.media_type = _MEDIA_TYPES.get(value, "IMAGE")
    setattr(owner, name, value)


def optional_settings(scene: bpy.types.Scene) -> dict[str, object]:
    """Return the capture settings, by path from the scene, that only some versions have."""
    settings = {}
    if hasattr(scene.cycles, "use_pixel_jitter"):
        # 5.x can move the only sample away from the pixel's centre, where K [R | t] says it is.
        settings["cycles.use_pixel_jitter"] = False
    return settings


def openvdb() -> ModuleType | None:
    """Return the module of Blender's OpenVDB, or None in a build without.

    Blender as a Python module brings it in a folder of its own, where Python does not look.
    """
    if "openvdb" not in sys.modules:
        found = importlib.util.find_spec("openvdb")
        if found is None:
            home = Path(bpy.utils.resource_path('LOCAL'), "python")
            files = [*home.glob("lib/python3*/site-packages/openvdb*"), *home.glob("Lib/site-packages/openvdb*")]
            found = importlib.util.spec_from_file_location("openvdb", files[0]) if files else None
        if found is None:
            return None
        sys.modules["openvdb"] = importlib.util.module_from_spec(found)
        found.loader.exec_module(sys.modules["openvdb"])
    return sys.modules["openvdb"]


def node_inputs(modifier: bpy.types.NodesModifier) -> list[object]:
    """Return the values that a user set for a modifier's node group; 5.x has a structure for each, 4.5 custom properties."""
    if not hasattr(modifier, "properties"):
        return list(modifier.values())
    inputs = modifier.properties.inputs
    given = [getattr(inputs, prop.identifier) for prop in inputs.bl_rna.properties if prop.type == 'POINTER']
    return [getattr(each, "value", None) for each in given]


_MEDIA_TYPES = {"OPEN_EXR_MULTILAYER": "MULTI_LAYER_IMAGE", "FFMPEG": "VIDEO"}
