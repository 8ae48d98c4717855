# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Plants one fault after the other in the kernels that carve and decode, in a copy of the clone, and tells whether the tests notice.

    .venv/blender-5.2/bin/python scripts/mutations.py            all of them; some minutes
    .venv/blender-5.2/bin/python scripts/mutations.py gray       those whose file's name holds a word

Exit status 1 if a fault is not found, or if a text is not in the code any more (tests/scripts/test_mutations.py sees to that).
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
CODE, TESTS = "addon/reconstruction/", "tests/reconstruction/"


class Fault(NamedTuple):
    """What is planted: in a file an exact text, which it holds once, becomes another; and the tests that should notice."""

    file: str
    old: str
    new: str
    tests: str


FAULTS = (
    Fault("volumetric/silhouette_test.py", "        right += 1\n        bottom += 1\n        top *= stride",
          "        bottom += 1\n        top *= stride", "volumetric/test_visual_hull.py volumetric/test_octree.py"),
    Fault("volumetric/silhouette_test.py", "        reach = size if self.conservative else size - 1\n        return reach",
          "        reach = size - 1\n        return reach", "volumetric/test_octree.py"),
    Fault("volumetric/silhouette_test.py", "((a | b | c | d) & 2) | (a & b & c & d & 1)", "((a | b | c | d) & 2) | ((a | b | c | d) & 1)",
          "volumetric/test_octree.py"),
    Fault("volumetric/octree.py", "missed[plane][rows] |= missed[plane - 1][rows] & outside", "missed[plane][rows] |= outside",
          "volumetric/test_octree.py"),
    Fault("volumetric/octree.py", "solid = alive & ~mixed", "solid = alive", "volumetric/test_octree.py"),
    Fault("volumetric/carving.py", "free[2 * axis + 1].astype(np.float32) - free[2 * axis]",
          "free[2 * axis].astype(np.float32) - free[2 * axis + 1]",
          "volumetric/test_carving.py volumetric/test_photo_hull.py"),
    Fault("volumetric/consistency.py", "(samples.views >= self.min_views) &", "(samples.views > self.min_views) &",
          "volumetric/test_consistency.py volumetric/test_photo_hull.py"),
    Fault("volumetric/ray_occupancy.py", "(farther + through) / (1 - occupancy)", "(farther + through)",
          "volumetric/test_ray_occupancy.py"),
    Fault("volumetric/light_image.py", "    if not (strict and len(out.rays)):", "    if len(out.rays) >= 0:",
          "volumetric/test_shadow_carving.py"),
    Fault("volumetric/light_image.py", "np.where(shadow, np.inf, -np.inf), voxel_size)", "np.where(shadow, np.inf, np.inf), voxel_size)",
          "volumetric/test_shadow_carving.py"),
    Fault("active/gray_code.py", "cv2.bitwise_xor(self._binary, on, dst=self._binary)",
          "cv2.bitwise_or(self._binary, on, dst=self._binary)",
          "active/test_gray_code.py"),
    Fault("active/gray_code.py", "cell if low else 0.0, (cell - 1) / 2,", "cell if low else 0.0, 0,", "active/test_gray_code.py"),
    Fault("active/phase_shift.py", "(turns + np.rint(coarse.position / np.float32(period) - turns))",
          "(turns + np.floor(coarse.position / np.float32(period) - turns))", "active/test_phase_shift.py"),
    Fault("active/triangulation.py", "Meeting((first + second) / 2,", "Meeting(first,", "active/test_triangulation.py"),
    Fault("active/peaks.py", "return 0.5 * (before - after)", "return (before - after)", "active/test_laser_stripe.py"),
)


def is_found(fault: Fault, clone: Path) -> bool:
    """Plant a fault in a clone, run the tests that should notice, and take it out again."""
    path = clone / CODE / fault.file
    text = path.read_text()
    if text.count(fault.old) != 1:
        raise SystemExit(f"mutations: {CODE}{fault.file}: holds {text.count(fault.old)} times: {fault.old!r}")
    path.write_text(text.replace(fault.old, fault.new))
    try:
        tests = [TESTS + name for name in fault.tests.split()]
        return subprocess.call([sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests], cwd=clone,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=1800) == 1  # some test has failed
    except subprocess.TimeoutExpired:  # a loop without an end is noticed
        return True
    finally:
        path.write_text(text)


def main() -> int:
    chosen = [fault for fault in FAULTS if all(word in fault.file for word in sys.argv[1:])]
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder, "clone")
        for part in ("addon", "tests", "scripts", "assets", "pyproject.toml"):
            source = ROOT / part
            (clone / part).parent.mkdir(exist_ok=True)
            shutil.copytree(source, clone / part, ignore=shutil.ignore_patterns("__pycache__")) if source.is_dir() \
                else shutil.copyfile(source, clone / part)
        for fault in chosen:
            found = is_found(fault, clone)
            missed += not found
            print(f"{'found' if found else 'NOT FOUND':10} {fault.file}: {fault.old.strip().splitlines()[0][:90]}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} faults found")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
