# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera and a projector side by side before a ball and a wall."""

import dataclasses

import pytest

from tests.projection import Round, Wall
from tests.rigs import Ball, camera_at


@pytest.fixture
def camera():
    """A camera two units before the origin."""
    return camera_at((0.0, -2.0, 0.1), focal=230.0, size=(160, 120))


@pytest.fixture
def projector():
    """A projector to its right that looks at the same place."""
    return camera_at((0.7, -1.9, 0.15), focal=180.0, size=(128, 96))


@pytest.fixture
def bent():
    """Return a device with distortion."""
    return lambda device: dataclasses.replace(device, distortion=(-0.1, 0.03, 0.002, -0.001, 0.0))


@pytest.fixture
def scene():
    """A ball before a wall."""
    return [Round(Ball((0.0, 0.0, 0.0), 0.3)), Wall((0.0, -1.0, 0.0), -0.6)]
