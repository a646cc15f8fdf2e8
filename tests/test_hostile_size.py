"""Input that is too large, or says that it is: refused at once, in little memory."""

import struct
import time
import zlib

import rasterio
import rasterio.shutil
from hostile import UTM, refused, vrt, write

from tin.reader import open as open_dem


def assert_quick_and_small(path, *codes, **options):
    start = time.perf_counter()
    refused(path, *codes, **options)
    assert time.perf_counter() - start < 2


def test_header_of_two_to_the_31_squared(tmp_path):
    write(tmp_path / "dem.tif")
    huge = 2**31 - 1
    assert_quick_and_small(vrt(tmp_path / "dem.vrt", size=(huge, huge)), "too-large")
    (tmp_path / "p5.pgm").write_bytes(f"P5 {huge} {huge} 255\n".encode() + bytes(100))
    assert_quick_and_small(tmp_path / "p5.pgm", "too-large")
    (tmp_path / "p2.pgm").write_bytes(f"P2 {2**31} {2**31} 255\n1 2 3".encode())
    assert_quick_and_small(tmp_path / "p2.pgm", "too-large")
    (tmp_path / "dem.pfm").write_bytes(f"Pf {huge} {huge} -1.0\n".encode() + bytes(100))
    assert_quick_and_small(tmp_path / "dem.pfm", "too-large", "not-a-raster")


def test_tiff_header_of_two_to_the_31_squared(tmp_path):
    data = bytearray(write(tmp_path / "dem.tif").read_bytes())
    (directory,) = struct.unpack_from("<I", data, 4)
    for entry in range(directory + 2, directory + 26, 12):
        assert struct.unpack_from("<H", data, entry)[0] in (256, 257)  # ImageWidth, ImageLength
        struct.pack_into("<HII", data, entry + 2, 4, 1, 2**31)
    (tmp_path / "dem.tif").write_bytes(data)
    assert_quick_and_small(tmp_path / "dem.tif", "too-large")


def test_over_max_pixels_is_refused_from_the_header(tmp_path):
    path = write(tmp_path / "dem.tif")
    assert open_dem(path, max_pixels=2000).n_valid == 2000
    refused(path, "too-large", says="1999", max_pixels=1999)


def test_plain_pgm_that_promises_more_than_it_holds(tmp_path):
    (tmp_path / "dem.pgm").write_bytes(b"P2 40000 40000 255\n1 2 3")
    assert_quick_and_small(tmp_path / "dem.pgm", "unreadable")


def test_decompression_bomb_tiff(tmp_path):
    size = {"height": 60000, "width": 60000, "count": 1, "transform": UTM, "crs": "EPSG:26710"}
    packing = {
        "compress": "deflate",
        "tiled": True,
        "blockxsize": 4096,
        "blockysize": 4096,
        "sparse_ok": True,
    }
    with rasterio.open(tmp_path / "bomb.tif", "w", driver="GTiff", dtype="uint8", **size, **packing):
        pass
    assert (tmp_path / "bomb.tif").stat().st_size < 10**5
    assert_quick_and_small(tmp_path / "bomb.tif", "too-large")


def test_decompression_bomb_png(tmp_path):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 16, 0, 0, 0, 0))
    body = chunk(b"IDAT", zlib.compress(bytes(10**6)))
    (tmp_path / "bomb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + body + chunk(b"IEND", b""))
    assert_quick_and_small(tmp_path / "bomb.png", "too-large")


def test_out_of_memory_is_an_error_of_ours(tmp_path, monkeypatch):
    from tin import sources

    def no_memory(heights, source):
        raise MemoryError

    monkeypatch.setattr(sources, "_void", no_memory)
    refused(write(tmp_path / "dem.tif"), "out-of-memory")


def test_xml_bomb(tmp_path):
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 20 if i else "x" * 50}">' for i in range(12))
    (tmp_path / "dem.vrt").write_text(f"<!DOCTYPE d [{entities}]><VRTDataset>&e11;</VRTDataset>")
    assert_quick_and_small(tmp_path / "dem.vrt", "unreadable", "not-a-raster")
