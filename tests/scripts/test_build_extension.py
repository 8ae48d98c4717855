# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension as Blender gets it: the archive is valid and complete, installs, and goes without leaving a trace.

Needs the network for the wheel, unless the extension has been built before: the wheel then lies in `dist/wheels`.
"""

import json
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from scripts import build_extension

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "build_extension.py"


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """Return the archive for this machine, built by the script as a user runs it, with the wheel of an earlier build."""
    out = tmp_path_factory.mktemp("dist")
    if (ROOT / "dist" / "wheels").is_dir():
        shutil.copytree(ROOT / "dist" / "wheels", out / "wheels")
    answer = subprocess.run([sys.executable, SCRIPT, "--out", out], capture_output=True, text=True, timeout=600)
    assert answer.returncode == 0, answer.stderr
    (path,) = answer.stdout.splitlines()
    return Path(path)


def test_it_holds_the_code_and_nothing_else(archive):
    with zipfile.ZipFile(archive) as file:
        names = set(file.namelist())
        manifest = tomllib.loads(file.read("blender_manifest.toml").decode())
    assert {"__init__.py", "blender_manifest.toml", "LICENSE", "reconstruction/geometry.py"} <= names
    unwanted = ("__pycache__", ".pyc", "tests", "scripts", ".git", ".blend1", "addon/")
    assert not [name for name in names if any(word in name for word in unwanted)]
    code = {str(path.relative_to(ROOT / "addon")) for path in (ROOT / "addon").rglob("*.py")}
    assert code == {name for name in names if name.endswith(".py")}
    assets = {str(path.relative_to(ROOT)) for path in (ROOT / "assets").rglob("*") if path.is_file()}
    assert assets == {name for name in names if name.startswith("assets/") and not name.endswith("/")}
    assert [f"./{name}" for name in sorted(names) if name.endswith(".whl")] == manifest["wheels"]
    assert len(manifest["wheels"]) == 1
    # What Blender itself reads of the platform when it splits the archive.
    platforms = manifest["build"]["generated"]["platforms"]
    assert [platform.replace("-", "_") for platform in platforms] == [archive.stem.rsplit("-", 1)[-1]]


def test_the_running_blender_finds_it_valid(archive):
    tool, tags = build_extension.extension_tool()
    answer = subprocess.run([sys.executable, tool, "validate", "--valid-tags", tags, archive], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout + answer.stderr


INSTALL = """
import json, sys
import bpy
import addon_utils  # exists once bpy is imported

MODULE = "bl_ext.user_default.scanstage"


def properties(kind):
    return sorted({*dir(kind), *kind.bl_rna.properties.keys()})


def traces():
    handlers = {name: len(found) for name in dir(bpy.app.handlers)
                if isinstance(found := getattr(bpy.app.handlers, name), list)}
    keymaps = bpy.context.window_manager.keyconfigs.addon
    return {"types": sorted(dir(bpy.types)), "scene": properties(bpy.types.Scene), "handlers": handlers,
            "object": properties(bpy.types.Object), "manager": properties(bpy.types.WindowManager),
            "operators": sorted(dir(bpy.ops.scanstage)),
            "keys": {k.name: len(k.keymap_items) for k in keymaps.keymaps} if keymaps else {}}


bpy.ops.wm.read_factory_settings()
before = traces()
bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
report = {"enabled": addon_utils.check(MODULE)[1], "file": sys.modules[MODULE].__file__, "cycles": []}
now = traces()
report["seen"] = [key for key in before if before[key] != now[key]]
import cv2
report["cv2"] = cv2.__version__
for _ in range(3):
    addon_utils.disable(MODULE)
    after = traces()
    report["cycles"].append({key: [before[key], after[key]] for key in before if before[key] != after[key]})
    addon_utils.enable(MODULE)
    report["enabled"] = report["enabled"] and addon_utils.check(MODULE)[1]
bpy.ops.preferences.addon_disable(module=MODULE)
report["disabled"] = not addon_utils.check(MODULE)[1]
with open(sys.argv[2], "w", encoding="utf-8") as file:
    json.dump(report, file)
"""


def test_it_installs_and_goes_without_a_trace(archive, tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}  # not the clone's `addon`
    environment["BLENDER_USER_RESOURCES"] = str(tmp_path / "user")
    answer = subprocess.run([sys.executable, "-c", INSTALL, archive, tmp_path / "report.json"], env=environment,
                            cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "Traceback" not in answer.stderr, answer.stderr
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["enabled"]
    assert Path(report["file"]).is_relative_to(tmp_path / "user")
    assert report["cv2"] == "4.11.0"
    assert {"types", "scene", "operators"} <= set(report["seen"])  # what is looked at does change
    assert report["cycles"] == [{}, {}, {}]
    assert report["disabled"]


def test_every_platform_has_a_wheel_and_a_hash():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert sorted(manifest["platforms"]) == sorted(build_extension.PIP_PLATFORMS)
    wheels = {build_extension.wheel_of(manifest, name) for name in manifest["platforms"]}
    assert {f"./wheels/{wheel}" for wheel in wheels} == set(manifest["wheels"])
    assert build_extension.REQUIREMENTS.read_text(encoding="utf-8").count("--hash=sha256:") == len(wheels)


def test_a_manifest_keeps_only_what_is_built():
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    full = tomllib.loads(text)
    wheel = Path(build_extension.wheel_of(full, "windows-x64"))
    kept = tomllib.loads(build_extension.manifest_for(text, {"windows-x64": wheel}))
    assert kept == {**full, "platforms": ["windows-x64"], "wheels": [f"./wheels/{wheel.name}"]}


def test_a_damaged_wheel_is_not_bundled(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(build_extension, "run", lambda *arguments: asked.append(arguments))
    (tmp_path / "opencv.whl").write_bytes(b"damaged")
    with pytest.raises(build_extension.BuildError, match=r"pip brought no opencv\.whl"):
        build_extension.fetch_wheel("linux-x64", "opencv.whl", tmp_path)
    assert "--require-hashes" in asked[0]
    assert not (tmp_path / "opencv.whl").exists()


@pytest.mark.parametrize("arguments", [("--platform", "amiga-m68k"), ("--platform", "linux-x64", "--all-platforms")])
def test_a_wrong_call_is_status_2(arguments):
    answer = subprocess.run([sys.executable, SCRIPT, *arguments], capture_output=True, text=True)
    assert answer.returncode == 2
    assert "Traceback" not in answer.stderr


def test_an_error_is_one_line(tmp_path):
    (tmp_path / "file").write_text("in the way")
    answer = subprocess.run([sys.executable, SCRIPT, "--out", tmp_path / "file"], capture_output=True, text=True)
    assert answer.returncode == 1
    assert answer.stderr.startswith("build_extension: error: ")
    assert len(answer.stderr.splitlines()) == 1
