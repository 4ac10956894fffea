# SPDX-License-Identifier: Apache-2.0
"""Grey images from PNG files, checked before a decoder sees them: decoders print of their own."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from skyhaul.errors import FileError
from skyhaul.sensors.api import GreyImage

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
"""Numbers of a pixel by PNG's colour type."""
PALETTE, PAETH = 3, 4
"""A colour type, and the last of the filters of a row."""


def read_png(file: Path, size_px: tuple[int, int]) -> GreyImage:
    """An 8-bit image; colours become grey.

    Raises:
        FileError: When it is missing, damaged, of another size or kind.
    """
    w, h = size_px
    what = f"{file}: is no image of {w} x {h} px"
    try:
        data = file.read_bytes()
    except OSError as error:
        raise FileError(f"{what}: it cannot be read: {error.strerror}") from error
    try:
        plain = _checked(data, size_px)
    except (ValueError, zlib.error, struct.error) as error:
        fault = str(error) if type(error) is ValueError else "its data are damaged"
        raise FileError(f"{what}: {fault}; give a plain 8-bit PNG") from None
    image = cv2.imdecode(np.frombuffer(plain, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None or image.shape != (h, w):
        raise FileError(f"{what}: it cannot be decoded; give a plain 8-bit PNG")
    return np.asarray(image, dtype=np.uint8)


def _checked(data: bytes, size_px: tuple[int, int]) -> bytes:
    """The image alone, unpacked, so that the decoder need not unpack it again.

    Raises:
        ValueError: With what is wrong.
    """
    if not data.startswith(_SIGNATURE):
        raise ValueError("it is no PNG" if data else "it is empty")
    header, packed = b"", []
    for kind, content in _chunks(data):
        if kind == b"IHDR":
            header, channels = content, _check_header(content, size_px)
        if kind == b"IDAT":
            packed.append(content)
    rows = zlib.compress(_unpacked(b"".join(packed), channels, size_px), 0)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", rows) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, content: bytes) -> bytes:
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of each chunk up to the end of the image."""
    at, kind = len(_SIGNATURE), b""
    while kind != b"IEND":
        length, name = struct.unpack_from(">I4s", data, at) if at + 12 <= len(data) else (0, b"")
        if at + 12 + length > len(data) or not name:
            raise ValueError("it is cut off")
        if (kind == b"") != (name == b"IHDR"):
            raise ValueError("its data are damaged")
        kind, content = name, data[at + 8 : at + 8 + length]
        (sum_read,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(content, zlib.crc32(name)) != sum_read:
            raise ValueError("its data are damaged (checksum)")
        yield kind, content
        at += 12 + length


def _check_header(content: bytes, size_px: tuple[int, int]) -> int:
    """Numbers of a pixel."""
    w, h, bits, colour, packing, filters, interlaced = struct.unpack(">IIBBBBB", content)
    if (w, h) != size_px:
        raise ValueError(f"it has {w} x {h} px, the resolution in the camera's description differs")
    if bits != 8 or colour == PALETTE or interlaced:
        kind = "a palette" if colour == PALETTE else "interlace" if interlaced else f"{bits} bits"
        raise ValueError(f"it has {kind}")
    if colour not in _CHANNELS or packing or filters:
        raise ValueError("its header is damaged")
    return _CHANNELS[colour]


def _unpacked(packed: bytes, channels: int, size_px: tuple[int, int]) -> bytes:
    """The rows, if they are as many as they must be and filtered in a way that there is."""
    w, h = size_px
    stride, stream = 1 + w * channels, zlib.decompressobj()
    raw = stream.decompress(packed, h * stride + 1)
    whole = len(raw) == h * stride and stream.eof and not stream.unused_data
    if not whole or max(raw[::stride]) > PAETH:
        raise ValueError("its data are damaged")
    return raw
