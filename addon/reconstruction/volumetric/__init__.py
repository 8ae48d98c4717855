# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumetric stereo: from many calibrated views to a set of voxels. One file, one system."""
