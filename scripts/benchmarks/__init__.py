# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What `benchmark.py` times, one module for each kind of kernel."""
