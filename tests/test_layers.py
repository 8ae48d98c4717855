# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What may import what, and the rules of the house that a program can check."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = {path.relative_to(ROOT).as_posix(): path for path in sorted((ROOT / "addon").rglob("*.py"))}
EVERY_FILE = pytest.mark.parametrize("name", FILES)
WITHOUT_BLENDER = ("reconstruction", "captures")
BLENDER = {"bpy", "bmesh", "mathutils", "bpy_extras", "gpu"}
# Stations of the data and their tools: the later may import the earlier, and only the faces import the faces.
MAY_IMPORT = {"reconstruction": {"reconstruction", "errors", "options", "progress", "memory"},
              "captures": {"captures", "reconstruction", "errors", "files", "options", "progress"}}


def imports_of(name: str) -> set[str]:
    """Return all modules that a file imports, anywhere in it, by their full names; those of the extension begin with addon."""
    package = name.split("/")[:-1]
    found = set()
    for node in ast.walk(ast.parse(FILES[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join([*package[:len(package) - node.level + 1], *filter(None, [node.module])]) if node.level else node.module
            found |= {f"{base}.{alias.name}" for alias in node.names}
    return found


def stations(name: str) -> set[str]:
    """Return the first names below ``addon`` that a file imports from."""
    return {module.split(".")[1] for module in imports_of(name) if module.startswith("addon.")}


def test_there_is_something_to_check():
    assert len(FILES) > 50 and "addon/reconstruction/methods.py" in FILES
    assert "addon.captures.scan.load_scan" in imports_of("addon/workflow.py")
    assert "addon.reconstruction.volumetric.visual_hull" in imports_of("addon/reconstruction/methods.py")


@pytest.mark.parametrize("name", [name for name in FILES if name.split("/")[1] in WITHOUT_BLENDER])
def test_reconstruction_and_captures_know_no_blender_and_no_later_station(name):
    assert not {module.split(".")[0] for module in imports_of(name)} & BLENDER
    assert stations(name) <= MAY_IMPORT[name.split("/")[1]]


@pytest.mark.parametrize("name", [name for name in FILES if name.startswith("addon/reconstruction/")])
def test_reconstruction_knows_no_files(name):
    assert not {module.split(".")[0] for module in imports_of(name)} & {"pathlib", "os", "io", "shutil", "tempfile"}
    calls = (node.func for node in ast.walk(ast.parse(FILES[name].read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
    assert "open" not in {call.id for call in calls if isinstance(call, ast.Name)}


@pytest.mark.parametrize("name", [name for name in FILES if name.split("/")[1] not in ("ui", "cli", "__init__.py")])
def test_only_the_faces_import_the_faces(name):
    assert not stations(name) & {"ui", "cli"}


@EVERY_FILE
def test_the_extension_imports_itself_by_relative_names(name):
    """Installed, it is not called ``addon``."""
    tree = ast.parse(FILES[name].read_text(encoding="utf-8"))
    absolute = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names} | {
        node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level}
    assert not {module.split(".")[0] for module in absolute} & {"addon"}


@pytest.mark.parametrize("name", [name for name in FILES if name != "addon/compat.py"])
def test_versions_are_told_apart_in_one_place(name):
    assert not re.search(r"\bapp\.version|\bapp import .*version", FILES[name].read_text(encoding="utf-8"))


@EVERY_FILE
def test_every_file_can_be_read_in_one_sitting_and_says_what_it_is(name):
    text = FILES[name].read_text(encoding="utf-8")
    assert text.count("\n") <= 400
    assert text.startswith("# SPDX-FileCopyrightText: 2026 Scanstage Authors\n# SPDX-License-Identifier: GPL-3.0-or-later\n")
    assert ast.get_docstring(ast.parse(text))


def run_without_blender(script: str) -> subprocess.CompletedProcess:
    blocked = f"import sys; sys.modules.update(dict.fromkeys({sorted(BLENDER)}))\n"  # None there makes an import fail
    return subprocess.run([sys.executable, "-c", blocked + script], cwd=ROOT, capture_output=True, text=True, timeout=120)


def test_blender_is_blocked_where_the_next_tests_say_so():
    assert "ModuleNotFoundError: import of bpy halted" in run_without_blender("import bpy").stderr


def test_the_numpy_module_the_captures_and_the_workflow_work_in_any_python():
    modules = [name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for name in FILES
               if name.split("/")[1] in WITHOUT_BLENDER or name in ("addon/__init__.py", "addon/workflow.py", "addon/cli/main.py")]
    done = run_without_blender("import importlib\nfor name in %r: importlib.import_module(name)\nprint('all')" % modules)
    assert (done.stdout, done.stderr) == ("all\n", "")


def test_verbs_that_need_no_blender_answer_without_it():
    done = run_without_blender("from addon.cli.main import main; sys.exit(main(['methods']))")
    assert (done.returncode, done.stderr) == (0, "") and "visual-hull" in done.stdout
