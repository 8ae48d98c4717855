# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Several workers give what one process gives, to the bit, also when one of them dies or sees no folder of the client's.

Scheduler and workers are processes of their own, as users start them; one test gives each an address of its own.
"""

import json
import os
import shutil
import site
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import bpy

# isort: split
import cv2  # bpy first: both bring libraries of their own
import numpy as np
import pytest

from addon.captures.store import read_capture
from addon.errors import Cancelled, ScanstageError
from addon.progress import silent
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.methods import METHODS
from addon.results.blend import new_file, save_blend
from addon.stage import staging
from tests.reconstruction.volumetric.test_shadow_carving import TRAY, scan_of
from tests.rigs import Ball, ring, write_ball_capture

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "scanstage.py"
DASK = ROOT / ".venv" / ("cluster-%d.%d" % sys.version_info[:2])
if DASK.is_dir():
    site.addsitedir(str(DASK))
pytest.importorskip("distributed", reason="dask is not installed; `python3 scripts/scanstage.py worker --help` installs it")

from cluster import connection  # noqa: E402 - needs dask
from cluster.frames import Frames  # noqa: E402
from cluster.volumes import Volumes  # noqa: E402

NOWHERE = "tcp://127.0.0.1:9"


@contextmanager
def process(*arguments, before=(), script=SCRIPT):
    """Run a verb that serves, until the block ends; yield the process and the address that it prints."""
    command = [*map(str, before), sys.executable, str(script), *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as started:
        try:
            yield started, started.stdout.readline().split()[2]
        finally:
            started.kill()


@pytest.fixture(scope="module")
def cluster():
    """Return a scheduler's address and a function that starts one more worker, of which two are there."""
    with ExitStack() as stack:
        _, address = stack.enter_context(process("scheduler", "tcp://127.0.0.1:0"))
        start = lambda: stack.enter_context(process("worker", address))[0]  # noqa: E731
        start(), start()
        yield address, start


@pytest.fixture
def connected(cluster):
    with connection.connected(cluster[0]) as found:
        yield found


@pytest.fixture(scope="module")
def tray():
    return scan_of(ring(5, elevation=35, focal=240, size=(160, 120)), TRAY)


def scanstage(*arguments, seconds=120):
    return subprocess.run([sys.executable, str(SCRIPT), *map(str, arguments)], capture_output=True, text=True, timeout=seconds)


def carve(method, scan, voxels, workers=None, progress=silent, **options):
    entry = METHODS[method]
    elsewhere = {name: getattr(workers, name) for name in entry.spread} if workers else {}
    return entry.function(scan, VoxelGrid.from_bounds((-1, -1, -0.9), (1, 0.93, 1), voxels), progress=progress, **elsewhere, **options)


def assert_same_outcome(found, expected):
    np.testing.assert_array_equal(found.volume.brick_map, expected.volume.brick_map)
    np.testing.assert_array_equal(found.volume.bricks, expected.volume.bricks)
    assert found.report == expected.report


def assert_same_pixels(folder, other):
    names = sorted(path.name for path in (other / "images").glob("*.png"))
    assert names == sorted(path.name for path in (folder / "images").glob("*.png"))
    for name in names:
        pictures = [cv2.imread(str(place / "images" / name), cv2.IMREAD_UNCHANGED) for place in (folder, other)]
        np.testing.assert_array_equal(*pictures)


@pytest.mark.parametrize("options", [{}, {"rule": "center", "tolerance": 1}])
def test_bricks_of_workers_are_the_hull(connected, tray, options):
    found, expected = (carve("visual-hull", tray, 100, workers, **options) for workers in (Volumes(connected, edge=32), None))
    assert_same_outcome(found, expected)
    assert found.volume.count() > 1000


def test_shadows_carve_the_same_on_workers(connected, tray):
    found, expected = (carve("shadow-carving", tray, 48, workers) for workers in (Volumes(connected, edge=16), None))
    assert_same_outcome(found, expected)
    assert expected.report["counts"]["rounds"] > 1 and expected.report["counts"]["carved"] > 100
    carved, at_home = found.layers["carved"], expected.layers["carved"]
    np.testing.assert_array_equal(carved.voxels, at_home.voxels)
    for name in at_home.values:
        np.testing.assert_array_equal(carved.values[name], at_home.values[name])
    assert found.pictures.keys() == expected.pictures.keys()


@pytest.mark.parametrize(("method", "voxels"), [("visual-hull", 128), ("shadow-carving", 48)])
def test_a_worker_that_is_killed_is_replaced(cluster, tray, method, voxels):
    address, start = cluster
    doomed, seen = start(), []

    def kill_in_the_middle(fraction, message):
        if message.startswith("Carving bricks" if method == "visual-hull" else "Carving by shadows"):
            seen.append(fraction)
            if fraction > seen[0]:
                doomed.kill()

    with connection.connected(address) as connected:
        assert connected.count() == 3
        found = carve(method, tray, voxels, Volumes(connected, edge=16), kill_in_the_middle)
        assert doomed.wait(timeout=10) and connected.count() == 2
    assert_same_outcome(found, carve(method, tray, voxels))


def test_carving_is_cancelled_as_at_home(connected, tray):
    def stop(fraction, message):
        if message == "Carving bricks":
            raise Cancelled

    with pytest.raises(Cancelled):
        carve("visual-hull", tray, 100, Volumes(connected, edge=16), stop)
    found = carve("visual-hull", tray, 40, Volumes(connected, edge=16))  # they are free again
    assert_same_outcome(found, carve("visual-hull", tray, 40))


@pytest.fixture(scope="module")
def staged(tmp_path_factory):
    """Return a staged file of six frames, and the capture set that is rendered from it without workers."""
    folder = tmp_path_factory.mktemp("staged")
    small = ["--set", "views=6", "--set", "resolution_x=96", "--set", "resolution_y=72"]
    assert scanstage("stage", "turntable", "--object", "knot", *small, "--out", folder / "rig.blend").returncode == 0
    assert scanstage("capture", folder / "rig.blend", "--out", folder / "here").returncode == 0
    return folder / "rig.blend", folder / "here"


def test_a_capture_with_a_worker_killed_has_the_pixels_of_home(cluster, staged, tmp_path):
    address, start = cluster
    doomed = start()
    command = [sys.executable, str(SCRIPT), "capture", str(staged[0]), "--out", str(tmp_path / "set"), "--scheduler", address]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as capture:
        while not list((tmp_path / "set").glob("images/*.png")) and capture.poll() is None:
            time.sleep(0.05)
        doomed.kill()
        errors = capture.communicate(timeout=120)[1]
    assert capture.returncode == 0, errors
    assert read_capture(tmp_path / "set").missing == ()
    assert (tmp_path / "set" / "capture.json").read_bytes() == (staged[1] / "capture.json").read_bytes()
    assert_same_pixels(tmp_path / "set", staged[1])


# --- bad input ----------------------------------------------------------------------------------------------------------------

def test_without_a_scheduler_one_sentence_and_nothing_written(staged, tmp_path):
    done = scanstage("capture", staged[0], "--out", tmp_path / "out", "--scheduler", NOWHERE, "--quiet")
    assert done.returncode == 1 and done.stdout == ""
    told = [line for line in done.stderr.splitlines() if not line.startswith("could not get a list of mounted")]  # Blender, in a container
    assert len(told) == 1 and told[0].startswith(f"scanstage: error: --scheduler: no scheduler answers at {NOWHERE}")
    assert not (tmp_path / "out").exists()


def test_a_scheduler_without_workers_is_told_apart(monkeypatch):
    monkeypatch.setattr(connection, "_FIRST_WORKER", 0.5)
    with process("scheduler", "tcp://127.0.0.1:0") as (_, address), pytest.raises(ScanstageError, match="has no workers; start some with"):
        with connection.connected(address):
            pass


def test_a_worker_of_another_version_is_refused(cluster, tmp_path):
    shutil.copytree(ROOT / "addon", tmp_path / "addon", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "scripts", tmp_path / "scripts", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / ".venv").symlink_to(ROOT / ".venv")
    with open(tmp_path / "addon" / "errors.py", "a") as file:
        file.write("# another version\n")
    with process("worker", cluster[0], script=tmp_path / "scripts" / "scanstage.py") as (_, worker):
        with pytest.raises(ScanstageError, match=f"worker {worker} has Scanstage [0-9a-f]+ instead of [0-9a-f]+; give it the same clone"):
            with connection.connected(cluster[0]):
                pass


def test_a_method_that_cannot_be_shared_is_refused_before_anything(staged, tmp_path):
    done = scanstage("reconstruct", staged[1], "stereo", "--out", tmp_path / "out", "--scheduler", NOWHERE)
    assert done.returncode == 1 and "method stereo runs on one machine only; those that workers can share are: visual-hull, shadow-carving" in done.stderr


# --- other machines -----------------------------------------------------------------------------------------------------------

def can_make_hosts():
    if os.name != "posix" or os.geteuid() != 0 or not shutil.which("ip") or not shutil.which("unshare"):
        return False
    name = f"scanstage-{os.getpid()}-try"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True).returncode == 0
    return made and subprocess.run(["ip", "netns", "delete", name], capture_output=True).returncode == 0


@contextmanager
def hosts(count):
    """Make hosts of a network of their own; yield its first address, which is ours, and the names of the hosts' namespaces."""
    bridge = f"sc{os.getpid() % 1000000}"
    names = [f"scanstage-{os.getpid()}-{number}" for number in range(count)]
    with ExitStack() as stack:
        def ip(*arguments, undo=None):
            subprocess.run(["ip", *arguments], check=True, capture_output=True)
            if undo:
                stack.callback(subprocess.run, ["ip", *undo], capture_output=True)

        ip("link", "add", bridge, "type", "bridge", undo=("link", "delete", bridge))
        ip("address", "add", "10.213.77.1/24", "dev", bridge)
        ip("link", "set", bridge, "up")
        for number, name in enumerate(names):
            ip("netns", "add", name, undo=("netns", "delete", name))
            ip("link", "add", f"{bridge}v{number}", "type", "veth", "peer", "name", "eth0", "netns", name)
            ip("link", "set", f"{bridge}v{number}", "master", bridge, "up")
            ip("-n", name, "address", "add", f"10.213.77.{number + 2}/24", "dev", "eth0")
            ip("-n", name, "link", "set", "eth0", "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield "10.213.77.1", names


@pytest.mark.skipif(not can_make_hosts(), reason="network namespaces need root and the program ip")
def test_hosts_with_addresses_of_their_own_that_see_no_folder_of_ours(staged, tmp_path):
    """Each worker is in a network namespace, and has an empty file system where the client has its files."""
    shared = tmp_path / "client"
    shared.mkdir()
    shutil.copy(staged[0], shared / "rig.blend")
    write_ball_capture(shared / "ball", Ball((0.1, 0.0, 0.0), 0.6), ring(6, focal=150, size=(120, 90)))
    with ExitStack() as stack:
        own, names = stack.enter_context(hosts(2))
        _, address = stack.enter_context(process("scheduler", f"tcp://{own}:0"))
        for number, name in enumerate(names):
            hidden = ("ip", "netns", "exec", name, "sh", "-c", f"mount -t tmpfs none '{shared}' && exec \"$@\"", "sh")
            worker = stack.enter_context(process("worker", address, before=hidden))[1]
            assert worker.startswith(f"tcp://10.213.77.{number + 2}:")
        captured = scanstage("capture", shared / "rig.blend", "--out", shared / "set", "--scheduler", address)
        assert captured.returncode == 0, captured.stderr
        assert_same_pixels(shared / "set", staged[1])
        ball = [shared / "ball", "visual-hull", "--voxels", "32", "--out"]
        found = scanstage("reconstruct", *ball, shared / "hull", "--scheduler", address, "--report", shared / "report.json")
        assert found.returncode == 0 and json.loads((shared / "report.json").read_text())["method"] == "visual-hull"
        assert scanstage("reconstruct", *ball, shared / "home").returncode == 0
        assert (shared / "hull" / "volume.npz").read_bytes() == (shared / "home" / "volume.npz").read_bytes()
        refuse_a_picture_that_only_we_see(shared, address)


def refuse_a_picture_that_only_we_see(folder, address):
    """A .blend that needs a file beside it cannot be sent."""
    new_file()
    staging.build(bpy.context.scene, "turntable", "knot", {"views": 3})
    cv2.imwrite(str(folder / "paint.png"), np.zeros((4, 4, 3), np.uint8))
    bpy.data.images.load(str(folder / "paint.png")).use_fake_user = True
    save_blend(folder / "painted.blend")
    done = scanstage("capture", folder / "painted.blend", "--out", folder / "none", "--scheduler", address, "--quiet")
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and not (folder / "none").exists()
    assert f"needs {folder / 'paint.png'}, and worker tcp://10.213.77." in done.stderr and "Pack Resources" in done.stderr


def test_a_blend_in_a_shared_folder_may_need_files_beside_it(connected, staged, tmp_path):
    (tmp_path / "paint.png").write_bytes(b"")
    Frames(connected, staged[0], [str(tmp_path / "paint.png")])
    with pytest.raises(ScanstageError, match=r"needs .*gone.png, and worker .* cannot see both"):
        Frames(connected, staged[0], [str(tmp_path / "paint.png"), str(tmp_path / "gone.png")])
