# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a result: everything in one file, nothing from anywhere, and no text that becomes markup."""

import base64
import json
from html.parser import HTMLParser

import pytest

from addon.errors import ScanstageError
from addon.results.folder import PREVIEW, REPORT
from addon.results.page import page_of, write_page
from addon.workflow import evaluate_result, reconstruct
from tests.rigs import Ball, ring, write_ball_capture


class Reader(HTMLParser):
    """Collects the texts, the pictures and the tags of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.sources, self.texts = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.sources += [value for name, value in attributes if name in ("src", "href")]

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    write_ball_capture(folder / "capture", Ball((0.1, 0.0, 0.0), 0.6), ring(8, focal=200, size=(160, 120)))
    reconstruct(folder / "capture", "visual-hull", folder / "result", voxels=32)
    evaluate_result(folder / "result")
    return folder / "result"


def test_the_page_holds_the_numbers_and_the_picture_and_fetches_nothing(result, tmp_path):
    write_page(result, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    page, report = Reader(text), json.loads((result / REPORT).read_text())
    assert "http:" not in text and "https:" not in text and "script" not in page.tags and "link" not in page.tags
    assert all(source.startswith("data:image/png;base64,") for source in page.sources) and page.sources
    assert base64.b64decode(page.sources[0].split(",", 1)[1]) == (result / PREVIEW).read_bytes()
    assert "Visual Hull" in page.texts and f"{report['counts']['occupied']:,}" in page.texts
    assert f"{report['evaluation']['surface']['accuracy_90']:.5g}" in page.texts
    for name in report["options"]:
        assert name in page.texts


def test_a_report_by_somebody_else_cannot_put_markup_into_the_page(result, tmp_path):
    for path in result.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    report = json.loads((tmp_path / REPORT).read_text())
    evil = "<script>alert(1)</script>' onload='x"
    report |= {"method": evil, "warnings": [evil, 3], "counts": {evil: evil}, "seconds": [evil], "grid": evil, "capture": evil,
               "silhouette_iou": {"views": {evil: 0.5, "b": "x"}}, "options": {evil: [evil]}, "evaluation": {evil: {evil: None}}}
    (tmp_path / REPORT).write_text(json.dumps(report))
    page = Reader(page_of(tmp_path))
    assert "script" not in page.tags and not any("alert" in source for source in page.sources)
    assert any("<script>alert(1)</script>" in text for text in page.texts)


def test_no_result_is_one_sentence_and_no_file(tmp_path):
    with pytest.raises(ScanstageError, match="name the folder of a result"):
        write_page(tmp_path, tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()
