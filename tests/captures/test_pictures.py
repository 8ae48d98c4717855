# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture files: exact decoding, and no half or false picture passes for a whole one."""

import struct
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest

from addon.captures.picture_format import read_header
from addon.captures.pictures import (
    picture_is_whole,
    picture_size,
    read_mask,
    read_picture,
    write_mask,
    write_picture,
)
from addon.errors import ScanstageError

NOISE = np.random.default_rng(1).integers(0, 256, (20, 30, 3), np.uint8)
FORMATS = (".png", ".jpg", ".tiff", ".ppm", ".pgm")


def encoded(suffix, pixels=NOISE, parameters=()):
    return cv2.imencode(suffix, pixels if suffix != ".pgm" else pixels[..., 0], list(parameters))[1].tobytes()


@pytest.mark.parametrize(("dtype", "most"), [(np.uint8, 255), (np.uint16, 65535)])
def test_srgb_is_decoded_by_the_standard_at_every_level(tmp_path, dtype, most):
    levels = np.arange(most + 1)
    value = levels / most  # IEC 61966-2-1, written out a second time
    expected = np.array([v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in value])
    path = tmp_path / "ramp.png"
    path.write_bytes(encoded(".png", levels.astype(dtype).reshape(-1, 256)))
    rgb, alpha = read_picture(path, "srgb")
    assert rgb.dtype == np.float32 and alpha is None
    np.testing.assert_allclose(rgb.reshape(-1, 3), np.repeat(expected[:, None], 3, axis=1), rtol=1e-7)  # float32 rounding
    linear, _ = read_picture(path, "linear")
    np.testing.assert_allclose(linear.reshape(-1, 3)[:, 0], value, rtol=1e-7)


def test_channels_are_red_green_blue_and_alpha_is_never_srgb(tmp_path):
    path = tmp_path / "x.png"
    path.write_bytes(encoded(".png", np.full((2, 3, 4), (0, 51, 255, 51), np.uint8)))  # OpenCV: B G R A
    rgb, alpha = read_picture(path, "srgb")
    assert rgb[0, 0, 0] == 1 and rgb[0, 0, 2] == 0 and 0 < rgb[0, 0, 1] < 0.1
    np.testing.assert_array_equal(alpha, np.float32(0.2))


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_is_read(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(encoded(suffix))
    rgb, _ = read_picture(path, "linear", size=(30, 20))
    assert rgb.shape == (20, 30, 3) and picture_size(path) == (30, 20) and picture_is_whole(path, (30, 20))
    if suffix not in (".jpg", ".pgm"):  # the others are lossless
        np.testing.assert_allclose(rgb, NOISE[..., ::-1] / np.float32(255), atol=1e-7)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_what_is_written_is_read_back_to_half_a_step(tmp_path, bits, encoding):
    rng = np.random.default_rng(2)
    rgb, alpha = rng.random((7, 9, 3)), rng.random((7, 9))
    path = tmp_path / "deep" / "x.png"
    write_picture(path, rgb, alpha, encoding=encoding, bits=bits)
    found, found_alpha = read_picture(path, encoding)
    step = 1 / (2 ** bits - 1)
    slope = 2.4 / 1.055 if encoding == "srgb" else 1  # the steepest that the decoding curve gets
    np.testing.assert_allclose(found, rgb, atol=0.5 * step * slope + 1e-6)  # 1e-6: float32
    np.testing.assert_allclose(found_alpha, alpha, atol=0.5 * step + 1e-6)
    assert [item.name for item in path.parent.iterdir()] == ["x.png"]  # and no temporary file is left


def test_a_mask_survives_the_round_trip(tmp_path):
    mask = NOISE[..., 0] > 99
    write_mask(tmp_path / "m.png", mask)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", size=(30, 20)), mask)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.9, 0.999])
def test_a_truncated_picture_is_not_whole_and_not_read(tmp_path, suffix, share):
    data = encoded(suffix)
    path = tmp_path / f"x{suffix}"
    path.write_bytes(data[:min(int(len(data) * share), len(data) - 1)])
    assert not picture_is_whole(path, (30, 20))
    with pytest.raises(ScanstageError, match=rf"^x{suffix}: is (cut off or damaged|not a PNG)"):
        read_picture(path, "srgb")


def test_a_cut_jpeg_is_not_whole_though_its_thumbnail_ends_properly(tmp_path):
    jpeg, thumbnail = encoded(".jpg"), encoded(".jpg", NOISE[:8, :8])
    with_thumbnail = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail + jpeg[2:]
    whole, cut = tmp_path / "whole.jpg", tmp_path / "cut.jpg"
    whole.write_bytes(with_thumbnail)
    cut.write_bytes(with_thumbnail[:-40])
    assert picture_is_whole(whole, (30, 20)) and not picture_is_whole(cut, (30, 20))
    np.testing.assert_array_equal(read_picture(whole, "srgb")[0].shape, (20, 30, 3))


def test_a_png_with_a_hole_of_zeros_is_not_whole(tmp_path):
    data = bytearray(encoded(".png"))
    data[len(data) // 2:len(data) // 2 + 20] = bytes(20)
    (tmp_path / "x.png").write_bytes(data)
    assert not picture_is_whole(tmp_path / "x.png", (30, 20))


def test_another_size_is_not_whole_and_is_refused(tmp_path):
    (tmp_path / "x.png").write_bytes(encoded(".png"))
    assert not picture_is_whole(tmp_path / "x.png", (20, 30))
    with pytest.raises(ScanstageError, match="^images/x.png: is 30x20 pixels, its camera 20x30"):
        read_picture(tmp_path / "x.png", "srgb", size=(20, 30), name="images/x.png")


def png_claiming(width, height):
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = [header, b"IDAT" + zlib.compress(b"\0" * 100), b"IEND"]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) for chunk in chunks)


@pytest.mark.parametrize("data", [png_claiming(2 ** 31 - 1, 2 ** 31 - 1), png_claiming(100_000, 100_000), png_claiming(0, 5),
                                  b"P6 999999999 999999999 255\n"], ids=["huge", "large", "empty", "pnm"])
def test_a_picture_that_claims_to_be_huge_is_refused_before_it_is_decoded(tmp_path, monkeypatch, data):
    def decode(*_):
        raise AssertionError("decoded")

    monkeypatch.setattr(cv2, "imdecode", decode)
    (tmp_path / "x.png").write_bytes(data)
    with pytest.raises(ScanstageError, match="^x.png: claims .* pixels"):
        read_picture(tmp_path / "x.png", "srgb")


def test_a_picture_whose_data_lie_about_its_size_is_refused(tmp_path):
    (tmp_path / "x.png").write_bytes(png_claiming(64, 64))  # whole chunks, right checksums, too little data
    with pytest.raises(ScanstageError, match="^x.png: is cut off or damaged"):
        read_picture(tmp_path / "x.png", "srgb")


def test_a_small_picture_takes_little_memory(tmp_path):
    write_picture(tmp_path / "a.png", np.zeros((20, 30, 3)))
    read_picture(tmp_path / "a.png", "linear")
    tracemalloc.start()
    read_picture(tmp_path / "a.png", "linear")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def test_what_is_no_picture_or_not_there_is_refused(tmp_path):
    (tmp_path / "x.png").write_text("hello")
    for path in (tmp_path / "x.png", tmp_path / "absent.png", tmp_path):
        assert not picture_is_whole(path, (1, 1))
        with pytest.raises(ScanstageError, match=f"^{path.name}: "):
            read_picture(path, "srgb")


@pytest.mark.parametrize("suffix", FORMATS)
def test_no_prefix_of_a_picture_crashes_the_header(suffix):
    data = encoded(suffix)
    for length in range(0, min(len(data), 700)):
        header = read_header(data[:length])
        assert header is None or not header.whole


@pytest.mark.parametrize("suffix", FORMATS)
def test_no_damage_crashes_the_header(suffix):
    data, rng = np.frombuffer(encoded(suffix), np.uint8), np.random.default_rng(3)
    for _ in range(300):
        damaged = data.copy()
        damaged[rng.integers(2, min(len(data), 200), 3)] = rng.integers(0, 256, 3)
        read_header(damaged.tobytes())  # any answer is right, an exception is not
