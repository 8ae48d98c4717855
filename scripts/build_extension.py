# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the extension that Blender installs, and prints its path.

The repository keeps the code in `addon/`, while an extension has it at its root. So everything is put together in
`dist/stage/` first, with the pinned wheels (`scripts/requirements/wheels.txt`, kept in `dist/wheels/`). Blender's own
extension tool, which comes with `bpy`, then builds the archive and validates it. Run it with the environment's
Python:

    .venv/blender-5.2/bin/python scripts/build_extension.py [--platform P | --all-platforms] [--out DIR]
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import platform
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REQUIREMENTS = ROOT / "scripts" / "requirements" / "wheels.txt"
PIP_PLATFORMS = {
    "linux-x64": "manylinux2014_x86_64",
    "macos-arm64": "macosx_13_0_arm64",
    "macos-x64": "macosx_13_0_x86_64",
    "windows-x64": "win_amd64",
}
"""The platforms of the extension, as Blender and as pip name them."""

IGNORED = shutil.ignore_patterns("__pycache__", ".*", "*.pyc", "*.blend[1-9]")


class BuildError(Exception):
    """The extension cannot be built; the message says why, and what to do."""


def build(platforms: list[str], out: Path) -> list[Path]:
    """Build and validate one archive for each platform.

    Parameters
    ----------
    platforms : list of str
        Keys of `PIP_PLATFORMS`.
    out : Path
        The folder for archives, made if need be. ``stage`` and ``wheels`` in it are working folders.

    Returns
    -------
    list of Path
        The archives, in the order of the platforms.

    Raises
    ------
    BuildError
    """
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    wheels = {name: fetch_wheel(name, wheel_of(manifest, name), out / "wheels") for name in platforms}
    stage = make_stage(wheels, out / "stage")
    tool, tags = extension_tool()
    archives = [out / f"{manifest['id']}-{manifest['version']}-{name.replace('-', '_')}.zip" for name in platforms]
    for archive in archives:
        archive.unlink(missing_ok=True)
    run(tool, "build", "--source-dir", stage, "--output-dir", out, "--split-platforms", "--valid-tags", tags)
    for archive in archives:
        if not archive.is_file():
            raise BuildError(f"Blender's extension tool made no {archive.name}; see the platforms in blender_manifest.toml")
        run(tool, "validate", "--valid-tags", tags, archive)
    return archives


def make_stage(wheels: dict[str, Path], stage: Path) -> Path:
    """Put the extension's files together in a new folder: code, manifest, licence, assets and wheels by platform."""
    shutil.rmtree(stage, ignore_errors=True)
    shutil.copytree(ROOT / "addon", stage, ignore=IGNORED)
    if not (stage / "__init__.py").is_file():
        raise BuildError("addon/__init__.py is missing: Blender would find no add-on")
    shutil.copytree(ROOT / "assets", stage / "assets", ignore=IGNORED)
    shutil.copy(ROOT / "LICENSE", stage)
    (stage / "wheels").mkdir()
    for wheel in wheels.values():
        shutil.copy(wheel, stage / "wheels")
    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    (stage / "blender_manifest.toml").write_text(manifest_for(manifest, wheels), encoding="utf-8")
    return stage


def manifest_for(manifest: str, wheels: dict[str, Path]) -> str:
    """Return the manifest's text without the platforms that are not built, and without their wheels."""
    kept = {*wheels, *(f"./wheels/{wheel.name}" for wheel in wheels.values())}
    lines = []
    for line in manifest.splitlines():
        entry = re.fullmatch(r'\s+"([^"]*)",', line)
        if entry is None or entry[1] in kept:
            lines.append(line)
    return "\n".join(lines) + "\n"


def wheel_of(manifest: dict, name: str) -> str:
    """Return the file name of a platform's wheel in the manifest."""
    for wheel in manifest["wheels"]:
        if name in manifest["platforms"] and wheel.endswith(f"{PIP_PLATFORMS[name]}.whl"):
            return Path(wheel).name
    raise BuildError(f"blender_manifest.toml has no wheel for {name}; its platforms are: {', '.join(manifest['platforms'])}")


def fetch_wheel(name: str, wheel: str, folder: Path) -> Path:
    """Return the path of a platform's wheel, downloaded unless it is there; its contents are the pinned ones.

    pip checks a download against the pinned hashes; a file that is there already is checked here.
    """
    path = folder / wheel
    if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() in REQUIREMENTS.read_text(encoding="utf-8"):
        return path
    folder.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    # The oldest Python that Blender brings; the stable ABI (abi3) serves the newer ones too.
    run("-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:",
        "--require-hashes", "--requirement", REQUIREMENTS, "--dest", folder, "--implementation", "cp",
        "--python-version", "3.11", "--abi", "abi3", "--platform", PIP_PLATFORMS[name])
    if not path.is_file():
        raise BuildError(f"pip brought no {wheel} for {name}; blender_manifest.toml and {REQUIREMENTS.name} disagree")
    return path


def extension_tool() -> tuple[Path, Path]:
    """Return Blender's extension tool and its list of tags, out of the bpy of this Python."""
    found = importlib.util.find_spec("bpy")
    if found is None or found.origin is None:
        raise BuildError("this Python has no bpy: run the script with .venv/blender-5.2/bin/python, "
                         "which scripts/scanstage.py makes on its first use")
    tools = sorted(Path(found.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not tools:
        raise BuildError(f"{Path(found.origin).parent}: there is no bl_pkg/cli/blender_ext.py in this bpy")
    return tools[0], tools[0].parents[3] / "modules" / "_bpy_internal" / "extensions" / "tags.py"


def run(*arguments) -> None:
    """Run this Python with arguments; what it prints is shown only if it fails."""
    answer = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True)
    if answer.returncode:
        said = [line for line in (answer.stdout + answer.stderr).splitlines() if line.strip()]
        what = " ".join(Path(str(argument)).name for argument in arguments[:3])
        raise BuildError(f"{what} failed: {said[-1].strip() if said else f'exit status {answer.returncode}'}")


def this_platform() -> str:
    """Return the extension's name for the machine that runs this."""
    system = {"Linux": "linux", "Darwin": "macos", "Windows": "windows"}.get(platform.system(), platform.system())
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(platform.machine().lower(), platform.machine())
    return f"{system}-{machine}"


def main() -> int:
    """Read the command line, build, and print the archives' paths."""
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--platform", default=this_platform(), help=f"{', '.join(PIP_PLATFORMS)} (default: this machine's)")
    choice.add_argument("--all-platforms", action="store_true", help="one archive for each")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR", help="default: dist")
    call = parser.parse_args()
    platforms = list(PIP_PLATFORMS) if call.all_platforms else [call.platform]
    if unknown := set(platforms) - PIP_PLATFORMS.keys():
        parser.error(f"there is no extension for {min(unknown)}: choose from {', '.join(PIP_PLATFORMS)}")
    try:
        archives = build(platforms, call.out.resolve())
    except (BuildError, OSError) as error:  # a full disk, a folder that may not be written
        print(f"build_extension: error: {error}", file=sys.stderr)
        return 1
    for archive in archives:
        print(archive)
    return 0


if __name__ == "__main__":
    sys.exit(main())
