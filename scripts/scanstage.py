# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Scanstage's command line from a clone.

    python3 scripts/scanstage.py demo                                       makes its own environment on first use
    blender --background --python scripts/scanstage.py -- demo              inside a real Blender

Both run `addon.cli.main`, as `blender --command scanstage` does once the extension is installed. Here alone are the verbs `scheduler` and
`worker`, and what `--scheduler` needs.
"""

import importlib.util
import os
import shutil
import site
import sys
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def load(name, file):
    """Import a module or package of the clone by its file, so that no search path needs to be changed."""
    folder = [str(file.parent)] if file.name == "__init__.py" else None
    spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=folder)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def load_cluster(environment, arguments):
    """Return the package `cluster` where a call needs it, with dask in reach: installed on first use, in a folder of its own."""
    serving = arguments[:1] in (["worker"], ["scheduler"])
    if not (serving or any(argument.startswith("--sched") for argument in arguments)):
        return None
    site.addsitedir(str(environment.install_cluster()))
    return load("cluster", ROOT / "scripts" / "cluster" / "__init__.py")


def main():
    has_blender = importlib.util.find_spec("bpy") is not None
    in_blender = "--" in sys.argv and Path(sys.argv[0]).name.lower().startswith("blender")
    arguments = sys.argv[sys.argv.index("--") + 1:] if in_blender else sys.argv[1:]
    environment = load("environment", ROOT / "scripts" / "environment.py")
    try:
        if not has_blender:
            return environment.run_again(__file__)
        if importlib.util.find_spec("cv2") is None:
            site.addsitedir(str(environment.install_opencv(ROOT / ".venv" / ("opencv-%d.%d" % sys.version_info[:2]))))
        load("addon", ROOT / "addon" / "__init__.py")
        cluster = load_cluster(environment, arguments)
    except environment.SetupError as error:
        print("scanstage: error: %s" % error, file=sys.stderr)
        return 1
    cli = importlib.import_module("addon.cli")
    try:
        if cluster is not None and arguments[0] in cluster.VERBS:
            return cluster.main(arguments)
        return cli.main(arguments, cluster=cluster)
    finally:
        if "bpy" in sys.modules:
            shutil.rmtree(sys.modules["bpy"].app.tempdir, ignore_errors=True)  # the end below leaves Blender no time for it


if __name__ == "__main__":
    try:
        code = main()
    except Exception:  # noqa: BLE001  # Blender would print it, too, and then end with 0
        traceback.print_exc()
        code = 1
    except KeyboardInterrupt:  # before there is a verb that could say what is whole
        code = 130
    sys.stdout.flush()
    sys.stderr.flush()
    # Without a window Blender ignores what a script returns, and its own shutdown may print to stdout: end here.
    os._exit(code)
