# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory that is predicted is what is then used, measured by the system in a process of its own; what does not fit is refused."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction import forecast
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.forecast import Forecast, Workload
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.methods import METHODS, reconstruct
from addon.reconstruction.scan import Scan
from tests.projection import Round, Wall, projected_view
from tests.reconstruction.volumetric.test_shadow_carving import lights_about, lit_view
from tests.rigs import Ball, camera_at, ring, views_of

ROOT = Path(__file__).resolve().parents[2]
BOUNDS = np.array([[-1.0, -1, -1], [1, 1, 1]])
BALL = Ball((0.0, 0.0, 0.0), 0.8)
LEAST = 200 << 20  # bytes: less is lost in what libraries take once
SLACK = 0.25
# What is asked for is large enough to matter and quick enough for a test.
REQUESTS = {
    "visual-hull": dict(voxels=640, views=6, width=320),
    "shadow-carving": dict(voxels=480, views=4, width=320, rounds=1),
    "voxel-coloring": dict(voxels=512, views=6, width=960, noise=0.3),
    "space-carving": dict(voxels=224, views=9, width=640, noise=0.3),
    "probabilistic-carving": dict(voxels=160, views=12, width=320, passes=2),
    "gray-code": dict(voxels=64, views=4, width=960),
}
MEASURE = """
import json, sys
from tests.reconstruction.test_forecast import large_scan, options_of
from addon.reconstruction.methods import reconstruct
def status(field):
    return next(int(line.split()[1]) << 10 for line in open("/proc/self/status") if line.startswith(field))
method, request = sys.argv[1], json.loads(sys.argv[2])
scan = large_scan(method, **request)
open("/proc/self/clear_refs", "w").write("5")  # the peak begins anew, with what is held now
held = status("VmRSS")
report = reconstruct(scan, method, voxels=request["voxels"], options=options_of(request)).report
print(json.dumps({"used": status("VmHWM") - held, "memory": report["memory"]}))
"""


def large_scan(method: str, *, views: int, width: int, **_) -> Scan:
    """Return a scan of a ball that takes a method more than a little memory."""
    size = (width, width * 3 // 4)
    if method == "gray-code":
        camera, projector = (camera_at(place, focal=1.2 * width, size=size) for place in ((0, -4, 0.2), (0.7, -3.9, 0.3)))
        patterns = make_patterns("gray-code", projector.size)
        seen = projected_view(camera, projector, patterns, [Round(BALL), Wall((0.0, -1.0, 0.0), -0.9)])
        return Scan(tuple(replace(seen, name=str(number)) for number in range(views)), BOUNDS)
    above = [camera_at((4 * np.cos(a), 4 * np.sin(a), 4.0), focal=1.9 * width, size=size) for a in 2 * np.pi * np.arange(views) / views]
    cameras = above if method == "voxel-coloring" else ring(views, focal=1.4 * width, size=size)
    if method == "shadow-carving":
        taken = [lit_view(str(number), camera, [BALL], lights_about(camera, 30.0)) for number, camera in enumerate(cameras)]
    else:
        taken = views_of(cameras, [BALL])
    return Scan(tuple(replace(view, read_image=lambda mask=view.mask: np.repeat(np.float32(0.5) * mask[..., None], 3, axis=2))
                      for view in taken), BOUNDS)


def options_of(request: dict) -> dict:
    """Return the method's options in a request."""
    return {name: value for name, value in request.items() if name not in ("voxels", "views", "width")}


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a part of a process's life is told by Linux alone")
@pytest.mark.parametrize("method", REQUESTS)
def test_the_memory_that_is_predicted_is_what_is_used(method):
    done = subprocess.run([sys.executable, "-c", MEASURE, method, json.dumps(REQUESTS[method])], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    used, predicted = found["used"], found["memory"]["predicted"]
    assert used >= LEAST  # or it would prove nothing
    assert (1 - SLACK) * used <= predicted <= (1 + SLACK) * used, f"predicted {predicted >> 20} MiB, used {used >> 20} MiB"
    # The report's own figure ends with the reconstruction; the libraries' peaks before it may hide a little of it.
    assert found["memory"]["used"] is None or abs(found["memory"]["used"] - used) <= 0.1 * used


@pytest.fixture(scope="module")
def scan():
    views = views_of(ring(6, elevation=15, focal=200, size=(160, 120)), [BALL])
    return Scan(tuple(replace(view, read_image=lambda: np.full((120, 160, 3), 0.4, np.float32)) for view in views), BOUNDS)


def forecast_of(scan: Scan, method: str = "visual-hull", **options) -> Forecast:
    return Forecast.of(METHODS[method].memory, scan, lambda voxels: VoxelGrid.from_bounds(*BOUNDS, voxels), options)


@pytest.mark.parametrize("method", METHODS)
def test_more_voxels_never_take_less(scan, method):
    seen = forecast_of(scan, method)
    needs = [seen.bytes(voxels) for voxels in range(1, 600)]
    assert needs == sorted(needs) and needs[0] < needs[-1]


def test_the_coarse_hull_tells_the_surface(scan):
    """The area of a surface's faces hardly depends on the size of the voxels."""
    found = reconstruct(scan, "visual-hull", voxels=192, options={"rule": "center"})
    sample = forecast_of(scan).sample
    assert sample.faces * 4 ** 2 == pytest.approx(found.report["counts"]["quads"], rel=0.05)  # 192 is four times 48
    assert sample.occupied * 4 ** 3 == pytest.approx(found.report["counts"]["occupied"], rel=0.05)


@pytest.mark.parametrize("method", METHODS)
def test_no_work_takes_more_than_that_for_an_object_that_fills_everything(scan, method):
    sample = forecast_of(scan, method).sample
    assert METHODS[method].memory(sample) <= METHODS[method].memory(Workload.most(sample.shape, sample.views, sample.pixels))


def test_too_many_voxels_are_refused_before_the_work_with_the_largest_count_that_fits(scan, monkeypatch):
    limit = forecast_of(scan).bytes(77)
    monkeypatch.setattr(forecast, "available_memory", lambda: limit)

    def no_work(fraction, message):
        raise AssertionError("the work has begun")

    with pytest.raises(ScanstageError, match=r"^--voxels: 3000 voxels a side may need .* GiB of memory .* at most 77 fit$"):
        reconstruct(scan, "visual-hull", voxels=3000, progress=no_work)
    assert reconstruct(scan, "visual-hull", voxels=77).volume.count()
    with pytest.raises(ScanstageError, match="at most 77 fit"):
        reconstruct(scan, "visual-hull", voxels=78, progress=no_work)


def test_pictures_that_do_not_fit_are_said_to_be_the_reason(scan, monkeypatch):
    monkeypatch.setattr(forecast, "available_memory", lambda: 1000)
    with pytest.raises(ScanstageError, match="the pictures alone are too many or too large$"):
        reconstruct(scan, "visual-hull", voxels=8)


def test_the_memory_is_told_before_the_work(scan):
    said = []
    report = reconstruct(scan, "visual-hull", voxels=96, progress=lambda fraction, message: said.append(message)).report
    assert said[0] == f"Memory needed: about {report['memory']['predicted'] / 2 ** 20:.0f} MiB"


def test_a_light_that_reaches_a_part_of_the_picture_is_told_from_one_that_fills_it():
    camera, projector = (camera_at(place, focal=200, size=(160, 120)) for place in ((0, -4, 0.2), (0.5, -3.9, 0.2)))
    patterns = make_patterns("gray-code", projector.size)
    ball, wall = ([projected_view(camera, projector, patterns, surfaces)] for surfaces in (
        [Round(Ball((0.0, 0.0, 0.0), 0.5))], [Wall((0.0, -1.0, 0.0), -0.6)]))
    few, many = (Forecast.of(METHODS["gray-code"].memory, Scan(tuple(views)), lambda voxels: VoxelGrid.from_bounds(*BOUNDS, voxels), {},
                             measures=True).sample.inside for views in (ball, wall))
    assert few == pytest.approx(np.pi * (0.5 * 200 / 4) ** 2, rel=0.2)  # less what is in shadow, more for being near
    assert many > 0.8 * 160 * 120
