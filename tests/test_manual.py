# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The manual is that of the program: its tables are in step, its commands can be called, its links lead somewhere."""

import bpy  # noqa: F401 - before OpenCV
import make_manual
import pytest

from addon.cli.main import build_parser
from addon.options import Option, Unit, resolve
from addon.reconstruction.methods import METHODS
from addon.stage.presets import PRESETS

PAGES = sorted(make_manual.DOCS.rglob("*.md"))


def test_every_method_has_its_page_in_step():
    """This much needs no Blender."""
    assert make_manual.bring_in_step(make_manual.DOCS, make_manual.method_tables(), check=True) == []
    assert make_manual.strays(make_manual.DOCS) == []


def test_the_pages_of_rigs_and_the_index_are_in_step():
    tables = {**make_manual.rig_tables(), **make_manual.index_tables(make_manual.DOCS)}
    assert make_manual.bring_in_step(make_manual.DOCS, tables, check=True) == []


def commands(text):
    """Return the calls of the command line in a page's code blocks, each as a list of its arguments."""
    blocks = text.replace("\\\n", " ").split("```")[1::2]
    lines = [line.removesuffix("&&").split() for block in blocks for line in block.splitlines()]
    return [line[2:] for line in lines if line[:2] == ["python3", "scripts/scanstage.py"]]


@pytest.mark.parametrize("name", METHODS)
def test_a_methods_command_leads_from_stage_to_evaluation(name):
    calls = [build_parser().parse_args(words) for words in commands(make_manual.read(make_manual.DOCS / f"methods/{name}.md"))]
    stage, capture, reconstruct, evaluate = calls
    preset = PRESETS[stage.preset]
    resolve(preset.options, dict(stage.settings), f"preset {preset.name}")
    resolve(METHODS[name].options, dict(reconstruct.settings), f"method {name}")
    assert reconstruct.method == name and make_manual.rig_of(make_manual.DOCS / f"methods/{name}.md") == preset.name
    assert (capture.file, reconstruct.capture, evaluate.result) == (stage.out, capture.out, reconstruct.out)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(make_manual.DOCS)))
def test_links_lead_somewhere(page):
    """A file that is there, and in it a heading by that name."""
    text = page.read_text(encoding="utf-8")
    for target in make_manual.LINK.findall(text):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), target
        assert not anchor or anchor in headings(linked.read_text(encoding="utf-8")), target


def headings(text):
    """Return the anchors of a page's headings, as GitHub makes them."""
    lines = [line.lstrip("# ").lower() for line in text.splitlines() if line.startswith("#")]
    return {"".join(c for c in line if c.isalnum() or c in " -_").replace(" ", "-") for line in lines}


# --- the script on pages of its own ----------------------------------------------------------------------------------------


@pytest.fixture
def manual(tmp_path):
    """Return a folder with a copy of the manual."""
    docs = tmp_path / "docs"
    for page in PAGES:
        copy = docs / page.relative_to(make_manual.DOCS)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(page.read_bytes())
    return docs


def test_a_changed_table_is_found_and_mended_and_prose_is_kept(manual, capsys):
    page = manual / "methods" / "stereo.md"
    right = page.read_text(encoding="utf-8")
    page.write_text(right.replace("| `block` | `5` |", "| `block` | `7` |"), encoding="utf-8")
    assert make_manual.perform(manual, check=True) == 1
    assert "docs/methods/stereo.md: out of step" in capsys.readouterr().err
    assert "`7`" in page.read_text(encoding="utf-8")
    assert make_manual.perform(manual, check=False) == 0
    assert page.read_text(encoding="utf-8") == right


@pytest.mark.parametrize("check", [True, False])
def test_a_missing_page_a_page_without_markers_and_a_page_too_many_are_named(manual, capsys, check):
    (manual / "methods" / "speckle.md").unlink()
    (manual / "methods" / "stereo.md").write_text("# Stereo\n", encoding="utf-8")
    (manual / "methods" / "telepathy.md").write_text("# Telepathy\n", encoding="utf-8")
    assert make_manual.perform(manual, check) == 1
    said = capsys.readouterr().err
    assert "docs/methods/speckle.md: missing" in said
    assert "docs/methods/stereo.md: must have one line" in said
    assert "docs/methods/telepathy.md: there is no such method" in said


def test_options_are_shown_as_they_are_typed():
    rows = make_manual.option_table((
        Option("turn", 0.5235987755982988, "How far", unit=Unit.ANGLE, minimum=0.0, maximum=1.5707963267948966),
        Option("count", 3, "How many", minimum=1),
        Option("shown", True, "Whether a|b"),
        Option("kind", "a", "Which", choices={"a": "the first", "b": "the second"}))).splitlines()[2:]
    assert rows == ["| `turn` | `30` | degrees | `0` to `90` | How far |",
                    "| `count` | `3` |  | at least `1`, whole | How many |",
                    "| `shown` | `true` |  | `true`, `false` | Whether a\\|b |",
                    "| `kind` | `a` |  | `a`, `b` | Which<br>`a`: the first<br>`b`: the second |"]
