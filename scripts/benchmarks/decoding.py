# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Gray code beside OpenCV's structured_light module."""

import time

from .measuring import median_seconds


def compare_decoding(runs, table):
    """Decode columns and rows of two cameras from the same pictures, by both programs, and compare every pixel both accept."""
    import cv2
    import numpy as np

    from addon.reconstruction.active.gray_code import decode_gray

    size, (width, height) = (1024, 1024), (1280, 720)
    pictures = gray_pictures(size, width, height)
    coded, (white, black) = list(pictures.values())[:-2], (pictures["white"], pictures["black"])
    half = len(coded) // 2
    pairs = [list(zip(part[::2], part[1::2], strict=True)) for part in (coded[:half], coded[half:])]

    def ours(robust=True):
        return [decode_gray(axis, white, black, length=size[0], robust=robust) for axis in pairs * 2]

    seconds, decoded = median_seconds(ours, runs)
    simple = median_seconds(lambda: ours(robust=False), runs)[0]
    for name, own in (("robust", seconds), ("simple", simple)):
        table.own(f"Gray code, {len(coded)} pictures of {width}x{height}, two cameras, {name}", own,
                  unit=f"{1e9 * own / (2 * width * height):.0f} ns a pixel")
    if not hasattr(cv2, "structured_light"):
        table.peer("OpenCV contrib `GrayCodePattern.decode`", None, seconds)
        return
    oracle = cv2.structured_light.GrayCodePattern.create(*size)
    started = time.perf_counter()
    oracle.decode([coded, coded], None, [black, black], [white, white])
    theirs = time.perf_counter() - started
    table.peer("OpenCV contrib `GrayCodePattern.decode`, one run, to robust", theirs, seconds)
    compared = same = 0
    for y, x in np.argwhere(decoded[0].valid & decoded[1].valid)[::37]:
        refused, place = oracle.getProjPixel(coded, int(x), int(y))
        compared += not refused
        same += not refused and place == (decoded[0].position[y, x], decoded[1].position[y, x])
    print(f"{same} of {compared} pixels that both accept are the same")


def gray_pictures(size, width, height):
    """Return 8-bit pictures of a rough surface under a Gray code, with noise, by the patterns' ids."""
    import numpy as np

    from addon.reconstruction.active.patterns import make_patterns

    random = np.random.default_rng(0)
    column = np.clip(np.linspace(0, size[0] - 1, width) + random.normal(0, 2, (height, width)), 0, size[0] - 1).astype(int)
    row = np.clip(np.linspace(0, size[1] - 1, height)[:, None] + random.normal(0, 2, (height, width)), 0, size[1] - 1).astype(int)
    albedo = random.uniform(0.05, 0.8, (height, width))
    return {pattern.id: np.clip(15 + albedo * pattern.image[row, column] + random.normal(0, 3, (height, width)), 0, 255).astype(np.uint8)
            for pattern in make_patterns("gray-code", size)}
