"""PNG files are read back by a decoder written from the standard's formulas, one byte at a time."""

import struct
import zlib

import numpy as np
import pytest
from radiosity.core.rendering.png import encode_png


def _chunks(data):
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    place, found = 8, []
    while place < len(data):
        (length,) = struct.unpack(">I", data[place : place + 4])
        kind, body = data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
        (check,) = struct.unpack(">I", data[place + 8 + length : place + 12 + length])
        assert check == zlib.crc32(kind + body)
        found.append((kind, body))
        place += 12 + length
    return found


def _paeth(a, b, c):
    distances = [(abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c)]
    return min(distances)[2]


def _decode(data):
    chunks = _chunks(data)
    assert [kind for kind, _ in chunks] == [b"IHDR", b"sRGB", b"IDAT", b"IEND"]
    width, height, depth, color, *rest = struct.unpack(">IIBBBBB", chunks[0][1])
    assert (depth, color, *rest) == (8, 2, 0, 0, 0)
    raw = zlib.decompress(chunks[2][1])
    stride = 3 * width
    lines, filters = [[0] * stride], []
    for row in range(height):
        kind, *line = raw[row * (stride + 1) : (row + 1) * (stride + 1)]
        for i in range(stride):
            a = line[i - 3] if i >= 3 else 0
            b = lines[-1][i]
            c = lines[-1][i - 3] if i >= 3 else 0
            line[i] = (line[i] + (0, a, b, (a + b) // 2, _paeth(a, b, c))[kind]) % 256
        lines.append(line)
        filters.append(kind)
    return np.array(lines[1:], dtype=np.uint8).reshape(height, width, 3), set(filters)


def _pictures():
    generator = np.random.default_rng(5)
    y, x = np.mgrid[:60, :80]
    yield "noise", generator.integers(0, 256, (40, 30, 3), dtype=np.uint8)
    yield "gradient", np.stack([x * 3, y * 4, x + y], axis=2).astype(np.uint8)
    yield "waves", (127 + 120 * np.sin(np.stack([x, y, x - y], axis=2) / 7)).astype(np.uint8)
    yield "one pixel", np.array([[[1, 2, 3]]], dtype=np.uint8)
    yield "one row", generator.integers(0, 256, (1, 50, 3), dtype=np.uint8)
    yield "one column", generator.integers(0, 256, (50, 1, 3), dtype=np.uint8)


@pytest.mark.parametrize(("name", "pixels"), list(_pictures()))
def test_decoded_picture_equals_the_encoded_one(name, pixels):
    np.testing.assert_array_equal(_decode(encode_png(pixels))[0], pixels)


def test_all_filters_occur_in_these_pictures():
    # Otherwise the round trip above would prove nothing about some of them.
    used = set().union(*(_decode(encode_png(pixels))[1] for _, pixels in _pictures()))
    assert used >= {1, 2, 3, 4}


def test_smooth_picture_is_much_smaller_than_its_pixels():
    y, x = np.mgrid[:256, :256]
    pixels = np.stack([x, y, (x + y) // 2], axis=2).astype(np.uint8)
    assert len(encode_png(pixels)) < 0.05 * pixels.size


@pytest.mark.parametrize("pixels", [np.zeros((2, 2), np.uint8), np.zeros((2, 2, 3)), np.zeros((0, 2, 3), np.uint8)])
def test_other_arrays_are_refused(pixels):
    with pytest.raises(ValueError, match="height, width, 3"):
        encode_png(pixels)
