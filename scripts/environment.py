# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the environments that the project runs in: one for each Blender, in `.venv/`, from pinned packages.

Standard library only, and any Python 3.8 or later can read it: it must be able to say which Python is needed.
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REQUIREMENTS = ROOT / "scripts" / "requirements"
BLENDERS = {(3, 13): "5.2", (3, 11): "4.5"}
"""The Blender LTS whose `bpy` runs in each Python."""

SYSTEM_LIBRARIES = {
    "libX11.so.6": "libx11-6", "libGL.so.1": "libgl1", "libXi.so.6": "libxi6", "libXfixes.so.3": "libxfixes3",
    "libXrender.so.1": "libxrender1", "libxkbcommon.so.0": "libxkbcommon0", "libSM.so.6": "libsm6", "libICE.so.6": "libice6",
}
"""What `bpy` needs of a Linux system, and Debian's package for each."""


class SetupError(Exception):
    """The environment cannot be made; the message says what to do."""


def version_of(python):
    """Return (major, minor) of an interpreter, or None if it does not run."""
    code = "import sys; print(*sys.version_info[:2])"
    try:
        answer = subprocess.run([str(python), "-c", code], capture_output=True, text=True, timeout=60)
    except OSError:
        return None
    return tuple(int(n) for n in answer.stdout.split()) if answer.returncode == 0 and answer.stdout else None


def interpreters():
    """Return {version: interpreter} for each supported Python that is found: this one, those on the path, pyenv's."""
    found = {}
    pyenv = sorted((Path.home() / ".pyenv" / "versions").glob("3.*/bin/python"))
    named = [shutil.which("python%d.%d" % version) for version in BLENDERS]
    for candidate in [sys.executable, *named, *pyenv]:
        version = version_of(candidate) if candidate else None
        if version in BLENDERS:
            found.setdefault(version, candidate)
    return found


def prepare(python=sys.executable, extras=(), say=lambda line: print(line, file=sys.stderr)):
    """Make the environment of one interpreter, unless it is there and up to date.

    Parameters
    ----------
    python : path
        An interpreter of one of the versions in `BLENDERS`.
    extras : sequence of {'development', 'experiments'}
        What to install besides Blender: what the tests need, what the experiments draw with.
    say : callable
        Takes one line of progress.

    Returns
    -------
    Path
        The environment's interpreter.

    Raises
    ------
    SetupError
        The Python is of another version, system libraries are missing, or packages cannot be installed.
    """
    version = version_of(python)
    if version not in BLENDERS:
        found = "Python %d.%d" % version if version else str(python)
        raise SetupError("Scanstage needs Python 3.13 (it then uses Blender 5.2 LTS) or Python 3.11 (Blender 4.5 LTS), "
                                "not %s: run this script with one of them, for example python3.13" % found)
    _require_system_libraries()
    files = [REQUIREMENTS / ("blender-%s.txt" % BLENDERS[version])] + [REQUIREMENTS / (extra + ".txt") for extra in extras]
    return _environment(python, "blender-" + BLENDERS[version], files, say)


def run_again(script, extras=()):
    """Run a script with the same arguments in its environment, made first if needed; return its exit status. See `prepare`."""
    command = [str(prepare(extras=extras)), str(Path(script).resolve()), *sys.argv[1:]]
    if os.name == "posix":
        sys.stderr.flush()
        os.execv(command[0], command)
    return subprocess.call(command)


def prepare_benchmark(say=lambda line: print(line, file=sys.stderr)):
    """Make the environment of the benchmarks, which needs no Blender, for the newest Python there is. See `prepare`."""
    found = interpreters()
    if not found:
        raise SetupError("the benchmarks need Python 3.13 or 3.11, and neither is on this machine")
    return _environment(found[max(found)], "benchmark", [REQUIREMENTS / "benchmark.txt"], say)


def _environment(python, name, files, say):
    """Make the environment `.venv/name` unless it is there with these requirement files installed; return its interpreter."""
    folder = ROOT / ".venv" / name
    interpreter = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    for file in files:
        stamp = folder / (file.stem + ".installed")
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        if stamp.exists() and stamp.read_text() == digest:
            continue
        if not interpreter.exists():
            say("Making the environment %s ..." % folder.relative_to(ROOT))
            _run([python, "-m", "venv", folder], "the Python module venv is needed (on Debian: apt-get install python3-venv)")
        say("Installing %s (once) ..." % ", ".join(_packages(file)))
        _run([interpreter, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", file],
             "the packages in %s could not be installed; is the network there?" % file.relative_to(ROOT))
        stamp.write_text(digest)
    return interpreter


def install_opencv(folder):
    """Install OpenCV for the running interpreter (a Blender that has none) into a folder of its own."""
    if not folder.exists():
        package = next(line for line in _packages(REQUIREMENTS / "blender-5.2.txt") if line.startswith("opencv"))
        _run([sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", folder, package],
             "OpenCV is not in this Blender and could not be installed; install the Scanstage extension, which brings it")
    return folder


def install_cluster(python=sys.executable, say=lambda line: print(line, file=sys.stderr)):
    """Install what `scripts/cluster` needs for an interpreter into a folder of its own, unless it is there; return the folder."""
    file, folder = REQUIREMENTS / "cluster.txt", ROOT / ".venv" / ("cluster-%d.%d" % version_of(python))
    stamp, digest = folder / "cluster.installed", hashlib.sha256(file.read_bytes()).hexdigest()
    if not (stamp.exists() and stamp.read_text() == digest):
        say("Installing %s (once) ..." % ", ".join(_packages(file)))
        shutil.rmtree(str(folder), ignore_errors=True)
        _run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--target", folder, "-r", file],
             "the packages in %s could not be installed; is the network there?" % file.relative_to(ROOT))
        stamp.write_text(digest)
    return folder


def _packages(file):
    return [line.strip() for line in file.read_text().splitlines() if line.strip() and not line.startswith("#")]


def _require_system_libraries():
    if not sys.platform.startswith("linux"):
        return
    missing = []
    for library, package in SYSTEM_LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(package)
    if missing:
        raise SetupError("Blender needs system libraries that are missing here; on Debian or Ubuntu: "
                                "apt-get install " + " ".join(missing))


def _run(command, problem):
    done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        last = "\n".join(done.stdout.strip().splitlines()[-3:])
        raise SetupError("%s\n%s" % (problem, last))
