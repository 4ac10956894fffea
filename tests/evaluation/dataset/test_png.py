# SPDX-License-Identifier: Apache-2.0
"""Images from outside: read, or refused before a decoder prints lines of its own."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.png import read_png

SIZE = (64, 48)
IMAGE = np.random.default_rng(0).integers(0, 256, (48, 64), dtype=np.uint8)
GOOD = cv2.imencode(".png", IMAGE)[1].tobytes()


def chunk(kind, content):
    data = kind + content
    return struct.pack(">I", len(content)) + data + struct.pack(">I", zlib.crc32(data))


def png(packed, bits=8, colour=0, interlace=0, size=SIZE):
    header = struct.pack(">IIBBBBB", *size, bits, colour, 0, 0, interlace)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    return GOOD[:8] + parts


def flipped(data, at):
    return data[:at] + bytes([data[at] ^ 255]) + data[at + 1 :]


ROWS = b"".join(b"\0" + row.tobytes() for row in IMAGE)


@pytest.mark.parametrize(
    "data", [GOOD, png(zlib.compress(ROWS)), GOOD[:33] + chunk(b"iCCP", b"xx") + GOOD[33:]]
)
def test_a_grey_image_is_what_was_written(tmp_path, capfd, data):
    (tmp_path / "x.png").write_bytes(data)
    np.testing.assert_array_equal(read_png(tmp_path / "x.png", SIZE), IMAGE)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("channels", [3, 4])
def test_a_colour_image_becomes_grey(tmp_path, channels):
    colour = np.dstack([IMAGE] * 3 + [np.full_like(IMAGE, 255)] * (channels - 3))
    cv2.imwrite(str(tmp_path / "x.png"), colour)
    np.testing.assert_allclose(read_png(tmp_path / "x.png", SIZE), IMAGE, atol=1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "it is empty"),
        (b"P5 64 48 255\n", "it is no PNG"),
        (cv2.imencode(".jpg", IMAGE)[1].tobytes(), "it is no PNG"),
        (GOOD[:8], "it is cut off"),
        (GOOD[:1000], "it is cut off"),
        (GOOD[:-5], "it is cut off"),
        (flipped(GOOD, len(GOOD) // 2), "its data are damaged (checksum)"),
        (flipped(GOOD, 20), "its data are damaged (checksum)"),
        (GOOD[:8] + GOOD[33:], "its data are damaged"),
        (png(b"garbage"), "its data are damaged"),
        (png(flipped(zlib.compress(ROWS), -1 % len(zlib.compress(ROWS)))), "its data are damaged"),
        (png(zlib.compress(ROWS[:-1])), "its data are damaged"),
        (png(zlib.compress(ROWS + b"\0")), "its data are damaged"),
        (png(zlib.compress(b"\7" + ROWS[1:])), "its data are damaged"),
        (png(zlib.compress(b"\0" * 50_000_000)), "its data are damaged"),
        (png(zlib.compress(ROWS), colour=7), "its header is damaged"),
        (png(zlib.compress(ROWS), colour=3), "it has a palette"),
        (png(zlib.compress(ROWS), bits=16), "it has 16 bits"),
        (png(zlib.compress(ROWS), interlace=1), "it has interlace"),
        (png(zlib.compress(ROWS), size=(32, 24)), "it has 32 x 24 px, the resolution in"),
    ],
)
def test_what_is_no_such_image_is_one_sentence(tmp_path, capfd, data, message):
    (tmp_path / "x.png").write_bytes(data)
    with pytest.raises(FileError) as caught:
        read_png(tmp_path / "x.png", SIZE)
    assert f"x.png: is no image of 64 x 48 px: {message}" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_missing_image_is_one_sentence(tmp_path):
    with pytest.raises(FileError, match="it cannot be read: No such file"):
        read_png(tmp_path / "x.png", SIZE)
