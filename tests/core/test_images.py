"""Image files are decoded as OpenCV decodes them; truncated, damaged and odd ones are refused."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from two_view_pose.core.errors import InputError
from two_view_pose.core.images import (
    read_image,
    read_image_size,
)

RGB = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_images_are_those_that_opencv_reads(tmp_path, suffix):
    path = written(tmp_path / f"a{suffix}", cv2.imencode(suffix, RGB[..., ::-1])[1].tobytes())
    expected = cv2.imread(str(path))[..., ::-1]
    np.testing.assert_array_equal(read_image(path), expected)
    assert read_image(path).flags.writeable and read_image_size(path) == (40, 60)
    gray = RGB[..., 0]
    cv2.imwrite(str(tmp_path / "g.png"), gray)
    np.testing.assert_array_equal(read_image(tmp_path / "g.png")[..., 2], gray)


def test_depth_keeps_its_sixteen_bits(tmp_path):
    depth = (RGB[..., 0].astype(np.uint16) << 8) + 7
    cv2.imwrite(str(tmp_path / "d.png"), depth)
    np.testing.assert_array_equal(read_image(tmp_path / "d.png", None), depth)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp", "webp", "jp2", "ppm", "gif"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_truncated_files_are_refused(tmp_path, suffix, share):
    Image.fromarray(RGB).save(tmp_path / f"whole.{suffix}")
    data = (tmp_path / f"whole.{suffix}").read_bytes()
    path = written(tmp_path / f"a.{suffix}", data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"a\..* is (not an image file|a truncated)"):
        read_image(path)


def test_a_thumbnail_does_not_hide_that_a_jpeg_is_truncated(tmp_path):
    """A thumbnail in its header is a JPEG that ends."""
    exif = Image.Exif()
    thumbnail = cv2.imencode(".jpg", RGB[::4, ::4])[1].tobytes()
    exif[0x9286] = thumbnail
    buffer = io.BytesIO()
    Image.fromarray(RGB).save(buffer, "JPEG", exif=exif)
    data = buffer.getvalue()
    assert b"\xff\xd9" in data[: len(data) * 3 // 4]
    read_image(written(tmp_path / "whole.jpg", data))
    with pytest.raises(ValueError, match="truncated"):
        read_image(written(tmp_path / "half.jpg", data[: len(data) * 3 // 4]))


def test_no_bit_of_a_png_may_flip(tmp_path):
    data = cv2.imencode(".png", RGB)[1].tobytes()
    for place in range(8, len(data) - 4, 97):
        changed = bytearray(data)
        changed[place] ^= 4
        with pytest.raises(ValueError):
            read_image(written(tmp_path / "a.png", bytes(changed)))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.png"):
        read_image(tmp_path / "none.png")
