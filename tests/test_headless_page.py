# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The script of the page about work without a window does what the page says, and its commands can be called."""

import contextlib
import io

import make_manual

from addon.captures.store import read_capture
from addon.cli.main import build_parser
from addon.results.ply import read_ply

PAGE = make_manual.DOCS / "headless.md"


def test_the_script_of_the_page_runs(empty_scene, tmp_path, monkeypatch):
    script = make_manual.read(PAGE).split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(script.replace("bl_ext.user_default.scanstage", "addon"), str(PAGE), "exec"), {})
    rows = [line.split() for line in said.getvalue().splitlines() if line[:2] in ("4 ", "8 ")]
    missed, overlap = ([float(row[column]) for row in rows] for column in (1, 2))
    assert missed[0] >= missed[1] and 0 < overlap[0] < overlap[1] < 1  # more views see no less, and carve more
    for views in (4, 8):
        assert len(read_capture(tmp_path / f"rigs/{views}").frames) == views
        assert len(read_ply(tmp_path / f"rigs/{views}.ply").triangles)
    assert not empty_scene.objects


def test_the_commands_of_the_page_can_be_called():
    lines = [line.split()[2:] for line in make_manual.read(PAGE).splitlines() if line.startswith("python3 scripts/scanstage.py")]
    calls = [build_parser().parse_args(words) for words in lines]
    stage, capture, reconstruct, evaluate = calls
    assert (capture.file, reconstruct.capture, evaluate.result) == (stage.out, capture.out, reconstruct.out)


def test_exit_status_is_as_the_page_says(capsys):
    from addon.cli.main import main

    assert main(["methods"]) == 0
    assert main(["evaluate", "no such folder"]) == 1
    assert "scanstage: error: " in capsys.readouterr().err
    assert main(["fly"]) == 2
