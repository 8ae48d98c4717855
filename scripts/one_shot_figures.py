# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of coloured stripes, for `figures.py`: simulated exactly, and how fast scanlines are matched."""

import sys
from pathlib import Path

import scanstage
from tables import print_head, print_line

ROOT = Path(__file__).resolve().parents[1]


def _trials():
    for name in ("rigs", "projection", "stripes"):
        scanstage.load(f"tests.{name}", ROOT / "tests" / f"{name}.py")
    return sys.modules["tests.stripes"]


def _print(title, figures):
    print_head(title, "figure", "target", "met")
    missed = 0
    for what, shown, target, met in figures:
        print_line(what, shown, target, "yes" if met else "no")
        missed += not met
    return missed


def stripes(bar):
    """Print what is matched in one picture of stripes, and in seven; return how many figures are missed."""
    trials = _trials()
    bar(0.0, "stripes")
    figures = [*_one_surface(trials), *_rod(trials), *_space_time(trials)]
    bar.close()
    return _print("stripes", figures)


def _one_surface(trials):
    for name, surface, colors, least, most_wrong in (
            ("white plane", trials.WALL, (0.8, 0.8, 0.8), 0.99, 0), ("white sphere", trials.BALL, (0.8, 0.8, 0.8), 0.99, 0),
            ("plane of albedo (0.8, 0.2, 0.2)", trials.WALL, (0.8, 0.2, 0.2), 0.9, None)):
        trial, code = trials.trial([surface], colors)
        share, wrong, count = trial.recall(code)
        yield f"{name}: visible edges matched, of {count}", f"{100 * share:.2f} %", f"at least {100 * least:g} %", share >= least
        if most_wrong is not None:
            yield f"{name}: wrong inside the silhouette", wrong, "0", wrong <= most_wrong


def _rod(trials):
    for passes in (8, 1):
        trial, code = trials.trial([trials.ROD, trials.WALL], passes=passes)
        shares = [trial.recall(code, surface=surface)[0] for surface in range(2)]
        yield (f"rod and background, {'several passes' if passes > 1 else 'one pass'}",
               " and ".join(f"{100 * share:.1f} %" for share in shares),
               "at least 90 % of both" if passes > 1 else "less than 90 % of one", (min(shares) >= 0.9) == (passes > 1))


def _space_time(trials):
    (fine, fine_right, many), (coarse, coarse_right, few) = (trials.textured_plane(frames) for frames in (7, 1))
    yield "space-time, textured plane: RMS by one picture's", f"{fine:.3g} / {coarse:.3g}", "at most 0.5", fine <= 0.5 * coarse
    yield ("space-time, textured plane: the same of points of the right stripe", f"{fine_right:.3g} / {coarse_right:.3g}", "at most 0.5",
           fine_right <= 0.5 * coarse_right)
    yield "space-time: points by one picture's", f"{many / few:.2f}", "at least 5", many >= 5 * few


def dynamic_programming(bar):
    """Print how fast scanlines are matched; return how many figures are missed."""
    bar(0.0, "dynamic programming")
    faster, apart = _trials().matching_speed()
    bar.close()
    return _print("dynamic programming, 720 x 140 x 125", [
        ("faster than plain Python, CPU time", f"{faster:.1f} times", "at least 20", faster >= 20),
        ("largest difference of a total", f"{100 * apart:.2g} %", "at most 1 %", apart <= 0.01)])


TABLES = {"stripes": stripes, "dynamic-programming": dynamic_programming}
