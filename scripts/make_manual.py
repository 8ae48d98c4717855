# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the manual's tables those of the program: options of methods and rigs, and the lists of both.

    python3 scripts/make_manual.py              rewrites what stands between the two markers of each page in docs/
    python3 scripts/make_manual.py --check      changes nothing; exit status 1 if a page is missing or out of step

All other text is written by hand. It makes its own environment on first use.
"""

import argparse
import re
import sys
from math import isinf
from pathlib import Path

import session

DOCS = Path(__file__).resolve().parents[1] / "docs"
BEGIN, END = "<!-- begin: written by scripts/make_manual.py -->", "<!-- end: written by scripts/make_manual.py -->"
_STAGE = re.compile(r"scanstage\.py stage ([\w-]+)")
LINK = re.compile(r"\]\(([^)\s]+)\)")
"""The target of a Markdown link."""


class ManualError(Exception):
    """A page cannot be brought up to date; the message says which and why."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only say which pages are missing or out of step")
    call = parser.parse_args()
    return session.run(__file__, lambda bar: perform(DOCS, call.check))


def perform(docs, check):
    """Rewrite the tables of all pages, or only check them; return the exit status."""
    complaints = bring_in_step(docs, {**method_tables(), **rig_tables(), **index_tables(docs)}, check) + strays(docs)
    for complaint in complaints:
        print(f"make_manual: error: {complaint}", file=sys.stderr)
    return int(bool(complaints))


def bring_in_step(docs, tables, check):
    """Rewrite the tables of these pages, or only check them; return what is wrong, one sentence each."""
    complaints = []
    for page, table in tables.items():
        try:
            text = read(docs / page)
            new = with_table(docs / page, text, table)
        except ManualError as error:
            complaints.append(str(error))
            continue
        if new != text and check:
            complaints.append(f"docs/{page}: out of step with the program; run scripts/make_manual.py")
        elif new != text:
            (docs / page).write_text(new, encoding="utf-8")
    return complaints


def method_tables():
    """Return the table of options of each method's page, by the page's path in the manual."""
    from addon.reconstruction.methods import METHODS

    return {f"methods/{name}.md": option_table(method.options) for name, method in METHODS.items()}


def rig_tables():
    """Return what is generated of the page of rigs: a section for each preset."""
    from addon.stage.presets import PRESETS

    sections = (f"## `{preset.name}`\n\n{preset.description}.\n\n{option_table(preset.options)}" for preset in PRESETS.values())
    return {"rigs.md": "\n\n".join(sections)}


def index_tables(docs):
    """Return what is generated of the manual's first page: the tables of methods and rigs. A method's rig is that of its page."""
    from tables import head, line

    from addon.reconstruction.methods import METHODS
    from addon.stage.presets import PRESETS

    rigs = {name: rig_of(docs / f"methods/{name}.md") for name in METHODS}
    methods = [line(f"[`{name}`](methods/{name}.md)", method.description, ", ".join(method.needs), linked_rig(rigs[name]))
               for name, method in METHODS.items()]
    presets = [line(linked_rig(name), preset.description, ", ".join(f"`{method}`" for method, rig in rigs.items() if rig == name))
               for name, preset in PRESETS.items()]
    return {"README.md": "\n".join((*head("method", "what it finds", "needs", "rig"), *methods, "",
                                    *head("rig", "what it is", "methods whose pages use it"), *presets))}


def linked_rig(name):
    """Return a rig's name as a link to its section."""
    return f"[`{name}`](rigs.md#{name})" if name else ""


def rig_of(page):
    """Return the rig that the command on a method's page stages, '' where there is none."""
    found = _STAGE.search(page.read_text(encoding="utf-8")) if page.is_file() else None
    return found[1] if found else ""


def option_table(options):
    """Return a table of options as Markdown: each option with its default, unit, bounds and meaning, its choices below."""
    from tables import head, line

    rows = [line(f"`{option.name}`", shown(option, option.default), option.unit.value, allowed(option), meaning(option))
            for option in options]
    return "\n".join((*head("option", "default", "unit", "allowed", "what it does"), *rows))


def shown(option, value):
    """Return a value as a user types it, without its unit."""
    return f"`{option.show(value).removesuffix(option.unit.value).strip()}`" if value != "" else "empty"


def allowed(option):
    """Return which values an option takes."""
    if option.choices:
        return ", ".join(f"`{choice}`" for choice in option.choices)
    if isinstance(option.default, bool):
        return "`true`, `false`"
    if isinstance(option.default, str):
        return "text"
    low, high = (None if isinf(bound) else shown(option, bound) for bound in (option.minimum, option.maximum))
    words = f"{low} to {high}" if low and high else f"at least {low}" if low else f"at most {high}" if high else "any"
    return f"{words}, whole" if isinstance(option.default, int) else words


def meaning(option):
    """Return what an option does and what its choices mean, for a cell."""
    choices = "".join(f"<br>`{choice}`: {text}" for choice, text in (option.choices or {}).items())
    return (option.description + choices).replace("|", "\\|")


def read(page):
    """Return a page's text.

    Raises
    ------
    ManualError
        There is no such page.
    """
    if not page.is_file():
        raise ManualError(f"{shortened(page)}: missing; write it, with a line {BEGIN!r} and a line {END!r} for its table")
    return page.read_text(encoding="utf-8")


def with_table(page, text, table):
    """Return a page's text with another table between its markers.

    Raises
    ------
    ManualError
        It has not one marker of each kind, in their order.
    """
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ManualError(f"{shortened(page)}: must have one line {BEGIN!r} and, below, one line {END!r}")
    before, after = text[:text.index(BEGIN)], text[text.index(END):]
    return f"{before}{BEGIN}\n\n{table}\n\n{after}"


def strays(docs):
    """Return a complaint for each page of a method that is no longer there."""
    known = method_tables()
    return [f"{shortened(page)}: there is no such method; remove the page" for page in sorted((docs / "methods").glob("*.md"))
            if f"methods/{page.name}" not in known]


def shortened(page):
    """Return a page's path as a reader of the project knows it."""
    return page.relative_to(page.parents[1] if page.parent.name == "docs" else page.parents[2])


if __name__ == "__main__":
    session.end(main())
