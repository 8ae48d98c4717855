# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Small valid files of other formats with something broken in them: an importer takes them or says one sentence."""


import os
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon.captures.importers import IMPORTERS, import_capture
from addon.captures.importers.sources import Import
from addon.captures.store import read_capture, write_capture
from addon.errors import ScanstageError
from addon.options import resolve
from tests.captures.test_pictures import png_claiming
from tests.sources import SOURCES, write_source

PIECES = ["", "nan", "-Infinity", "1e999", "-1", "0", "9" * 400, "1e-320", "../", "/", "\\", "\0", "\n", " ", "[", "]", "{", "}", "%", "#", ";",
          "=", ":", "é", "\ud800", "\u2028", "\ufeff", "view_1.png", "view_2.png", "x" * 5000, "<a>" * 200, "[" * 200, "- " * 200, "\"", "null",
          "true", "1e5", "..", "&lol;", "|", "'"]
ENDS = ("view_1.png", "view_2.png", "view_3.png")


@st.composite
def broken(draw, text):
    """Return the bytes of a text after a few pieces of it were replaced, doubled or cut out."""
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 12)))
        piece = draw(st.sampled_from(PIECES) | st.just(text[start:end] * 2) | st.text(max_size=3))
        text = text[:start] + piece + text[end:]
    data = text.encode("utf-8", "surrogatepass")
    return data[:draw(st.integers(0, len(data)))] if draw(st.integers(0, 9)) == 0 else data


def read(folder, case, content=None) -> Import:
    """Read a source as its importer does, without the copy that all importers share."""
    importer = IMPORTERS[case.split()[0]]
    return importer.function(write_source(folder, case, content), **resolve(importer.options, {}, "import"))


def taken_or_refused(tmp_path, case, content):
    try:
        found = read(tmp_path, case, content)
    except ScanstageError as error:
        assert str(error).isprintable() and len(str(error)) < 600
        return
    write_capture(tmp_path / "set", found.capture)  # raises a ValueError if the set could not be read back
    assert all(path.resolve().is_relative_to(tmp_path.resolve()) for path in found.pictures.values())


@pytest.mark.parametrize("case", SOURCES)
def test_the_whole_file_is_read(tmp_path, case):
    frames = read(tmp_path, case).capture.frames
    assert len(frames) == {"slstudio": 3, "desk": 4}.get(case, 2)


@pytest.mark.parametrize("case", SOURCES)
@settings(max_examples=100, deadline=1000, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(st.data())
def test_a_broken_file_is_refused_in_one_sentence(tmp_path, case, data):
    taken_or_refused(tmp_path, case, data.draw(broken(SOURCES[case][1])))


FOUND = {  # what such searches found: the file with these changes once crashed, hung or took all memory
    "a number of 400 digits": ("opencv", "%YAML:1.0\n---\n", "%YAML:1.0\n---\na: " + "9" * 400 + "\n"),
    "a node after it": ("opencv", "P_2: !!opencv-matrix", "P_2: !!opencv-mat\x7f\u0122wix  rows: " + "9" * 400),
    "in a matrix": ("opencv", "7.5", "9" * 400),
    "hexadecimal": ("opencv", "%YAML:1.0\n---\n", "%YAML:1.0\n---\na: 0x" + "9" * 40 + "\n"),
    "in JSON": ("opencv json", "{", '{"a": 99999999999, '), "in XML": ("opencv xml", "<P_1 ", "<a>99999999999</a><P_1 "),
    "surrogates": ("colmap", "view_1", "view_1\udcff"), "a name too long": ("colmap", "view_1", "x" * 5000),
    "a name of nothing": ("middlebury", "view_1.png", "\x00"), "infinite rows": ("opencv", "rows: 3", "rows: .inf"),
}


@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_is_taken_or_refused(tmp_path, name):
    case, old, new = FOUND[name]
    assert old in SOURCES[case][1]
    taken_or_refused(tmp_path, case, SOURCES[case][1].replace(old, new, 1).encode("utf-8", "surrogatepass"))


@pytest.mark.parametrize(("case", "old", "new"), [
    ("opencv", "%YAML:1.0\n---\n", "%YAML:1.0\n---\ncalibrated: 20231116120000\nserial: [ 12345678901, 2 ]\n"),
    ("opencv json", "{", '{"calibrated": 20231116120000, '), ("opencv xml", "<P_1 ", "<calibrated>20231116120000</calibrated><P_1 ")])
def test_whole_numbers_that_do_not_fit_32_bits_spoil_nothing_after_them(tmp_path, case, old, new):
    before = read(tmp_path, case).capture
    after = read(tmp_path, case, SOURCES[case][1].replace(old, new, 1).encode()).capture
    for name, camera in before.cameras.items():
        assert (after.cameras[name].P == camera.P).all()


# Pictures


@pytest.mark.parametrize("case", SOURCES)
def test_pictures_that_claim_to_be_huge_or_nothing_are_refused(tmp_path, case):
    folder = write_source(tmp_path, case)
    for size in ((2 ** 31 - 1, 2 ** 31 - 1), (2 ** 20, 2), (0, 5)):
        for picture in folder.rglob("view_*.png"):
            picture.write_bytes(png_claiming(*size))
        with pytest.raises(ScanstageError, match=r"^view_\d.png: claims \d+x\d+ pixels; use a picture of 1 to"):
            read(tmp_path, case)


@pytest.mark.parametrize("case", SOURCES)
def test_no_picture_is_read_through_a_link_out_of_the_folder(tmp_path, case):
    folder, elsewhere = tmp_path / "set", tmp_path / "elsewhere"
    write_source(folder, case)
    elsewhere.mkdir()
    for picture in list(folder.rglob("view_2.png")):
        secret = elsewhere / "-".join(picture.relative_to(folder).parts)
        picture.rename(secret)
        picture.symlink_to(secret)
    with pytest.raises(ScanstageError, match="view_2.png.* is a link out of the source's folder; copy the file itself into it"):
        read(folder, case)


@pytest.mark.parametrize("case", SOURCES)
def test_no_calibration_is_read_through_a_link_out_of_the_folder(tmp_path, case):
    folder = tmp_path / "set"
    name = SOURCES[case][0]
    write_source(folder, case)
    (folder / name).rename(tmp_path / name)
    (folder / name).symlink_to(tmp_path / name)
    with pytest.raises(ScanstageError, match=f"{name}.* is a link out of the source's folder"):
        importer = IMPORTERS[case.split()[0]]
        importer.function(folder, **resolve(importer.options, {}, "import"))


def test_pictures_whose_names_no_other_system_takes_are_renamed(tmp_path):
    folder = write_source(tmp_path / "set", "turntable")
    names = ["a\nb.png", "12:30.png", "back\\slash.PNG", "trésor 1.png"]
    for name in names:
        (folder / name).write_bytes((folder / "view_1.png").read_bytes())
    capture = import_capture("turntable", folder, tmp_path / "out")
    assert len(capture.frames) == 6 and all(frame.image.isprintable() for frame in read_capture(tmp_path / "out").frames)
    assert "images/trésor 1.png" in {frame.image for frame in capture.frames}
    (folder / names[0]).write_bytes(b"nothing")
    with pytest.raises(ScanstageError) as caught:
        import_capture("turntable", folder, tmp_path / "out")
    assert str(caught.value).startswith("a?b.png: ")


# Real calibrations


@pytest.mark.parametrize(("importer", "folder", "file"), [
    ("opencv", "turntable_squirrel", "viff.xml"), ("middlebury", "dino_sparse_ring", "dinoSR_par.txt"),
    ("slstudio", "gray_code_skull", "calibration.xml"), ("desk", "desk_shadow_bowl", "annotations.json")])
def test_a_real_calibration_with_something_broken_is_taken_or_refused(tmp_path, real_captures, importer, folder, file):
    """One change in each of 60 copies: a byte, a cut, a piece doubled, or one of the pieces above in its place."""
    source = real_captures(folder)
    shutil.copytree(source, tmp_path, dirs_exist_ok=True, copy_function=shutil.copyfile, ignore=shutil.ignore_patterns("*.mat"))
    os.chmod(tmp_path, 0o700)
    data, rng = (source / file).read_bytes(), np.random.default_rng(11)
    taken = 0
    for _ in range(60):
        start = int(rng.integers(len(data)))
        end = start + int(rng.integers(0, 30))
        piece = [bytes([rng.integers(256)]), b"", data[start:end] * 2, PIECES[rng.integers(len(PIECES))].encode("utf-8", "surrogatepass")]
        changed = data[:start] + piece[rng.integers(4)] + data[end:]
        (tmp_path / file).write_bytes(changed)
        try:
            IMPORTERS[importer].function(tmp_path, **resolve(IMPORTERS[importer].options, {}, "import"))
            taken += 1
        except ScanstageError as error:
            assert str(error).isprintable() and len(str(error)) < 600
    assert 0 < taken < 60
