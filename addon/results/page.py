# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result as one page for any browser: the report's numbers in tables, and its pictures, which are part of the file.

Nothing is fetched from anywhere, so that the page can be sent, printed and opened years later. All text is escaped: a report
may come from somebody else.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path

from ..captures.files import read_bytes
from ..files import replacing
from ..reconstruction.evaluation import EXPLAINED
from ..reconstruction.methods import METHODS
from .folder import PICTURES, PREVIEW, read_report

MOST_PICTURES = 12
_MOST_BYTES = 1 << 23  # of one picture
_STYLE = """
:root { color-scheme: light dark; --ink: #1d1f21; --quiet: #667; --line: #d8dade; --paper: #fff; --warn: #fff4d6; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e6e6; --quiet: #9aa; --line: #3a3d42; --paper: #1b1d20; --warn: #4a3c12; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 2rem auto; max-width: 64rem;
  padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: 0; } h2 { font-size: 1.1rem; margin-top: 2rem; } p.quiet { color: var(--quiet); margin-top: 0.2rem; }
table { border-collapse: collapse; width: 100%; }
td { text-align: left; padding: 0.25rem 0.7rem 0.25rem 0; border-bottom: 1px solid var(--line); }
td.number { text-align: right; font-variant-numeric: tabular-nums; width: 12rem; } td.says { color: var(--quiet); }
img { max-width: 100%; border-radius: 4px; } figure { margin: 0; } figcaption { color: var(--quiet); font-size: 0.85rem; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(18rem, 1fr)); gap: 1rem; }
.warning { background: var(--warn); padding: 0.5rem 0.8rem; border-radius: 4px; margin: 0.4rem 0; }
"""


def write_page(folder: Path, out: Path) -> None:
    """Write the page of a result folder.

    Parameters
    ----------
    folder : Path
    out : Path
        The file to write; it appears whole or not at all.

    Raises
    ------
    ScanstageError
        The folder is no result, or the disk refuses.
    """
    text = page_of(Path(folder))
    with replacing(out) as file:
        file.write(text.encode())


def page_of(folder: Path) -> str:
    """Return the page as HTML.

    Raises
    ------
    ScanstageError
        The folder is no result.
    """
    report = read_report(folder)
    method = str(report.get("method", ""))
    entry = METHODS.get(method)
    title, says = (entry.label, entry.description) if entry else (method, "")
    parts = [f"<h1>{escape(title)}</h1><p class='quiet'>{escape(says)}</p>", _figure(folder / PREVIEW, "The result")]
    parts += [f"<p class='warning'>{escape(str(warning))}</p>" for warning in _list(report.get("warnings"))]
    for group, measures in _mapping(report.get("evaluation")).items():
        parts.append(_table(f"Compared with the truth: {group}", ((name, value, EXPLAINED[name].meaning if name in EXPLAINED else "")
                                                                  for name, value in _mapping(measures).items())))
    parts.append(_table("Counts", _mapping(report.get("counts")).items()))
    parts.append(_table("Seconds", _mapping(report.get("seconds")).items()))
    meaning = {option.name: option.description for option in entry.options} if entry else {}
    parts.append(_table("Options", ((name, value, meaning.get(name, "")) for name, value in _mapping(report.get("options")).items())))
    grid = _mapping(report.get("grid"))
    parts.append(_table("Grid", (("voxel size", grid.get("voxel_size")), ("voxels", " x ".join(map(str, _list(grid.get("shape"))))),
                                 ("origin", ", ".join(map(_shown, _list(grid.get("origin"))))))))
    views = _mapping(_mapping(report.get("silhouette_iou")).get("views"))
    ious = {name: value for name, value in views.items() if isinstance(value, float)}
    parts.append(_table("Silhouettes, intersection over union, the worst first", sorted(ious.items(), key=lambda item: item[1])))
    pictures = sorted((folder / PICTURES).glob("*.png"))[:MOST_PICTURES]
    if pictures:
        parts.append("<h2>Pictures</h2><div class='pictures'>" + "".join(_figure(path, path.stem) for path in pictures) + "</div>")
    body = "\n".join(part for part in parts if part)
    return (f"<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><title>Scanstage: {escape(title)}</title>"
            f"<meta name='viewport' content='width=device-width'><style>{_STYLE}</style></head>\n<body>\n{body}\n"
            f"<p class='quiet'>Capture: {escape(str(report.get('capture', '')))}</p>\n</body></html>\n")


def _table(title: str, rows: Iterable[tuple]) -> str:
    """Return a titled table of names, values and perhaps what they mean; nothing if there are no rows."""
    lines = []
    for name, value, *says in rows:
        shown = escape(_shown(value))
        lines.append(f"<tr><td>{escape(str(name).replace('_', ' '))}</td><td class='number'>{shown}</td>"
                     + "".join(f"<td class='says'>{escape(str(text))}</td>" for text in says) + "</tr>")
    return f"<h2>{escape(title)}</h2>\n<table>{''.join(lines)}</table>" if lines else ""


def _shown(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _figure(path: Path, caption: str) -> str:
    if not path.is_file() or path.is_symlink():
        return ""
    data = base64.b64encode(read_bytes(path, _MOST_BYTES)).decode()
    caption = escape(caption, quote=True)
    return f"<figure><img src='data:image/png;base64,{data}' alt='{caption}'><figcaption>{caption}</figcaption></figure>"


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}


def _list(value: object) -> list:
    return value if isinstance(value, list) else []
