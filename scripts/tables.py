# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables as Markdown, for the scripts that print figures."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table of results.

    Parameters
    ----------
    titles : tuple of str
        With units.
    rows : tuple of tuples
        Numbers or text, one for each title.
    note : str
        What a reader must know to read it.
    """

    titles: tuple
    rows: tuple
    note: str = ""

    def __post_init__(self):
        for row in self.rows:
            if len(row) != len(self.titles):
                raise ValueError(f"the row {row} must have {len(self.titles)} cells")

    def column(self, title):
        """Return the cells under a title."""
        return [row[self.titles.index(title)] for row in self.rows]

    def markdown(self):
        """Return the table's lines, and the note below them."""
        lines = [*head(*self.titles), *(line(*row) for row in self.rows)]
        return "\n".join(lines + ["", self.note] * bool(self.note))


def head(*titles):
    """Return the two lines that begin a table."""
    return line(*titles), line(*["---"] * len(titles))


def line(*cells):
    """Return one row. Numbers that are not whole get four significant digits."""
    return "| " + " | ".join(map(_text, cells)) + " |"


def print_head(*titles):
    """Print the two lines that begin a table, after an empty one."""
    print("", *head(*titles), sep="\n", flush=True)


def print_line(*cells):
    """Print one row at once: the next may take minutes."""
    print(line(*cells), flush=True)


def _text(cell):
    if cell is None:
        return ""
    if isinstance(cell, int):
        return f"{cell:,}"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
