"""Images of every mode, depth and EXIF orientation are read as OpenCV reads them, or refused."""

import struct
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms
from two_view_pose.core.errors import InputError
from two_view_pose.core.images import (
    IMAGE_SUFFIXES,
    MAX_PIXELS,
    read_image,
    read_image_size,
    read_mask,
    read_photograph,
    write_image,
)

RAMP = np.array([[0, 12800, 25600, 38400, 51200, 63900]], np.uint16).repeat(4, axis=0)
RGB = np.random.default_rng(0).integers(0, 255, (4, 6, 3), np.uint8)


def of_opencv(path: Path, flags: int = cv2.IMREAD_COLOR) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(path), flags), cv2.COLOR_BGR2RGB)


@pytest.mark.parametrize("suffix", ["png", "tif", "pgm", "ppm"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_sixteen_bits_are_divided_by_256(tmp_path, suffix, channels):
    if (suffix, channels) in (("pgm", 3), ("pgm", 4), ("ppm", 1), ("ppm", 4)):
        pytest.skip("the format has no such images")
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), RAMP if channels == 1 else np.dstack([RAMP] * channels))
    # libtiff and netpbm divide by 257.
    np.testing.assert_allclose(read_image(path).astype(int), of_opencv(path), atol=1)
    np.testing.assert_allclose(read_image(path)[0, :, 1], [0, 50, 100, 150, 200, 249], atol=1)


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr"])
@pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "webp", "bmp", "gif"])
def test_every_mode_is_read_as_by_opencv(tmp_path, mode, suffix):
    path, with_alpha = tmp_path / f"a.{suffix}", np.dstack([RGB, RGB[..., :1]])
    if (mode, suffix) == ("RGBA", "tif"):
        pytest.skip("libtiff multiplies colors by alpha; of PNG and WebP it is dropped")
    image = Image.fromarray(RGB if mode in ("P", "CMYK", "YCbCr") else with_alpha)
    image = image.convert("LA").convert(mode) if mode in ("1", "L", "LA") else image.convert(mode)
    try:
        image.save(path)
    except (OSError, ValueError):
        pytest.skip("the format has no such images")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ours = read_image(path)
    np.testing.assert_allclose(ours.astype(int), of_opencv(path), atol=2)


def test_a_transparent_palette_is_read_without_warning(tmp_path):
    image = Image.fromarray(RGB).quantize(8)
    image.save(tmp_path / "a.png", transparency=bytes([0, 128, 255]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image.convert("RGB"))


def test_a_lab_tiff_has_the_colors_that_were_converted(tmp_path):
    profiles = ImageCms.createProfile("sRGB"), ImageCms.createProfile("LAB")
    image = Image.fromarray(RGB // 2 + 60)
    lab = ImageCms.applyTransform(image, ImageCms.buildTransform(*profiles, "RGB", "LAB"))
    lab.save(tmp_path / "a.tif")
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), image, atol=6)


def tiff(bits: int, pixels: bytes, size: tuple[int, int], photometric: int = 1) -> bytes:
    """A gray TIFF of ``size`` (W, H)."""
    tags = {256: size[0], 257: size[1], 258: bits, 259: 1, 262: photometric, 273: 122, 277: 1}
    tags |= {278: size[1], 279: len(pixels)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    return struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + entries + bytes(4) + pixels


def test_tiffs_of_twelve_bits_and_with_white_as_zero(tmp_path):
    levels = [0, 800, 1600, 2400, 3200, 4000]  # TIFF 6.0: packed, high bits first
    bits = "".join(f"{level:012b}" for level in levels)
    packed = int(bits, 2).to_bytes(9, "big")
    (tmp_path / "12.tif").write_bytes(tiff(12, packed, (6, 1)))
    expected = [level * 255 // 4095 for level in levels]
    np.testing.assert_allclose(read_image(tmp_path / "12.tif")[0, :, 0], expected, atol=1)
    (tmp_path / "w.tif").write_bytes(tiff(16, RAMP[0].tobytes(), (6, 1), photometric=0))
    np.testing.assert_array_equal(read_image(tmp_path / "w.tif"), of_opencv(tmp_path / "w.tif"))


@pytest.mark.parametrize(
    ("name", "pixels", "match"),
    [
        ("f.tif", RAMP.astype(np.float32) / 65535, "floating-point"),
        ("f.pfm", RAMP.astype(np.float32), "floating-point"),
        ("i.tif", RAMP.astype(np.int32), "32-bit integers"),
        ("photo.heic", b"\0\0\0\x18ftypheic", "heic is not read: convert"),
        ("empty.jpg", b"", "is not an image file"),
        ("offset.tif", tiff(8, bytes(24), (6, 4)).replace(bytes([122, 0, 0, 0]), b"\xff" * 4), ""),
    ],
)
def test_what_has_no_defined_colors_is_refused_by_name(tmp_path, name, pixels, match):
    path = tmp_path / name
    if isinstance(pixels, bytes):
        path.write_bytes(pixels)
    else:
        (Image.fromarray(pixels) if isinstance(pixels, np.ndarray) else pixels).save(path)
    for read in (read_image, read_photograph):
        with pytest.raises(InputError, match=f"{name} .*{match}"):
            read(path)


def test_the_preview_of_a_raw_photograph_is_refused(tmp_path):
    Image.fromarray(RGB).save(tmp_path / "a.dng", "TIFF", tiffinfo={254: 1})
    with pytest.raises(InputError, match="raw photograph"):
        read_image(tmp_path / "a.dng")


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int32, np.float32, bool])
@pytest.mark.parametrize("value", [1, 255])
def test_masks_of_any_bits(tmp_path, kind, value):
    inside = RGB[..., 0] > 100
    Image.fromarray(inside if kind is bool else (inside * value).astype(kind)).save(
        tmp_path / "m.tif"
    )
    np.testing.assert_array_equal(read_mask(tmp_path / "m.tif"), inside)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "P"])
def test_masks_of_any_mode(tmp_path, mode):
    inside = RGB[..., 0] > 100
    Image.fromarray(inside).convert("L").convert("RGB").convert(mode).save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), inside)


@pytest.mark.parametrize("orientation", range(10))
@pytest.mark.parametrize("suffix", ["png", "jpg", "webp", "tif"])
def test_orientation_is_obeyed_in_photographs_alone(tmp_path, orientation, suffix):
    picture = np.kron(RGB, np.ones((16, 16, 1), np.uint8))
    exif = Image.Exif()
    exif[274] = orientation
    path, plain = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    tags = {"tiffinfo": {274: orientation}} if suffix == "tif" else {"exif": exif}
    for file, options in ((path, tags), (plain, {})):
        Image.fromarray(picture).save(file, quality=90, **options)
    stored = of_opencv(plain, cv2.IMREAD_COLOR)
    found, turned = read_photograph(path)
    assert turned == (orientation if 1 <= orientation <= 8 else 1)
    np.testing.assert_allclose(read_image(path).astype(int), stored, atol=2)
    assert read_image_size(path) == (64, 96)
    if suffix == "tif":  # OpenCV 5 fails on some of these
        cv2.imwrite(str(tmp_path / "c.png"), stored[..., ::-1])
        Image.open(tmp_path / "c.png").save(path := tmp_path / "d.png", exif=exif)
    np.testing.assert_allclose(found.astype(int), of_opencv(path), atol=2)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF")
def test_damaged_exif_data_do_not_hide_a_photograph(tmp_path):
    Image.fromarray(RGB).save(tmp_path / "a.jpg", exif=b"Exif\0\0II*\0\xff\xff\xff\xff")
    assert read_photograph(tmp_path / "a.jpg")[1] == 1


@pytest.mark.parametrize(("width", "height"), [(12800, 9600), (16320, 12240)])
def test_too_many_pixels_are_refused_by_name(tmp_path, width, height):
    assert width * height > MAX_PIXELS

    def chunk(kind: bytes, data: bytes) -> bytes:
        checked = kind + data
        return struct.pack(">I", len(data)) + checked + struct.pack(">I", zlib.crc32(checked))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    path = tmp_path / "large.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    for read in (read_image, read_photograph, read_image_size):
        with pytest.raises(InputError, match=r"large\.png is too large.* scale the image down"):
            read(path)


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_images_are_written_as_their_suffix_says(tmp_path, suffix):
    path = tmp_path / "new" / f"a{suffix.upper()}"
    picture = np.kron(RGB, np.ones((16, 16, 1), np.uint8))
    write_image(path, picture)
    assert np.abs(of_opencv(path).astype(int) - picture).mean() < 10
