# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The two ways in which work ends without a result."""


class ScanstageError(Exception):
    """The input cannot be used.

    The message is one sentence that names the file and the field (where there is one) and says what to do.
    Both faces show it as it is: the command line with exit status 1, Blender as an error report. Names of files may hold
    line breaks and what no terminal can show: in a message these are question marks.
    """

    def __init__(self, sentence: str = "") -> None:
        super().__init__("".join(letter if letter.isprintable() else "?" for letter in sentence))


class Cancelled(Exception):
    """The user stopped the work. Raised out of a progress callback, and let through by everything in between."""
