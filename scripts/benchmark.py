# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Times the kernels beside what a user would pick instead, in one run, on this machine.

    python3 scripts/benchmark.py carve        visual hull: Open3D, a compiled brute force
    python3 scripts/benchmark.py mesh         voxels to a mesh: scikit-image's marching cubes
    python3 scripts/benchmark.py decode       Gray code: OpenCV's structured_light module
    python3 scripts/benchmark.py coloring     voxel coloring at the size of the paper of 1997: a compiled projection and gather
    python3 scripts/benchmark.py shadows      shadow carving: the hull alone, and its growth with views and lights
    python3 scripts/benchmark.py              all of them
    python3 scripts/benchmark.py cluster      workers beside one process: volumes and captures (with Blender, and by itself)

    python3 scripts/benchmark.py --write      all of them, and the table into the README

Medians of several runs after a warm-up. Only the ratios mean anything on another machine. It makes an environment of its
own (without Blender) for the peers, and says which of them were not there.
"""

import argparse
import importlib.util
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- begin: written by scripts/benchmark.py --write -->", "<!-- end: written by scripts/benchmark.py --write -->"
KERNELS = ("carve", "mesh", "decode", "coloring", "shadows")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kernel", nargs="?", choices=[*KERNELS, "cluster", "all"], default="all")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--write", action="store_true", help="put the table into the README")
    parser.add_argument("--alone", metavar="N", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--dense", action="store_true", help=argparse.SUPPRESS)
    call = parser.parse_args()
    if call.kernel == "cluster":
        import session

        return session.end(session.run(__file__, lambda bar: time_cluster(call.runs)))
    if importlib.util.find_spec("cv2") is None or importlib.util.find_spec("skimage") is None:
        return run_in_environment()
    load_addon()
    from benchmarks import carving, coloring, decoding, measuring, shadows

    if call.alone:
        return carving.print_alone(call.alone, dense=call.dense)
    compare = {"carve": carving.compare_carving, "mesh": carving.compare_meshing, "decode": decoding.compare_decoding,
               "coloring": coloring.compare_coloring, "shadows": shadows.time_shadows}
    table = measuring.Comparison()
    for kernel in KERNELS if call.kernel == "all" else (call.kernel,):
        compare[kernel](call.runs, table)
    if call.write:
        write_table(ROOT / "README.md", table.lines)
    return 0


def write_table(path, lines):
    """Put a table between the two marks of a page."""
    before, rest = path.read_text(encoding="utf-8").split(BEGIN)
    path.write_text("\n".join((before + BEGIN, "", *lines, "", END + rest.split(END)[1])), encoding="utf-8")


def run_in_environment():
    import environment

    try:
        python = environment.prepare_benchmark()
    except environment.SetupError as error:
        print(f"benchmark: error: {error}", file=sys.stderr)
        return 1
    return subprocess.call([python, Path(__file__).resolve(), *sys.argv[1:]])


def time_cluster(runs):
    import site

    import environment
    from benchmarks import cluster

    site.addsitedir(str(environment.install_cluster()))
    cluster.time_cluster(runs)
    return 0


def load_addon():
    """Import the clone's `addon` by its file."""
    spec = importlib.util.spec_from_file_location("addon", ROOT / "addon" / "__init__.py", submodule_search_locations=[str(ROOT / "addon")])
    sys.modules["addon"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules["addon"])


if __name__ == "__main__":
    sys.exit(main())
