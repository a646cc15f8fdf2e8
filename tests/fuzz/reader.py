"""Mutate small rasters and open them: a DEM or a TinError has to come of it, within ten seconds.

    python tests/fuzz/reader.py --seconds 60

starts from the files of the corpus beside this one and from what rasterio writes here. A file that raises
anything else, crashes or hangs is kept; ``reader.py FILE...`` tries it again.
"""

from __future__ import annotations

import argparse
import collections
import faulthandler
import gzip
import logging
import multiprocessing
import multiprocessing.connection
import os
import random
import re
import shutil
import struct
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import numpy as np

CORPUS = Path(__file__).parent / "corpus"
LIMIT_S = 10
MEMORY = 4 << 30
MAX_PIXELS = 2_000_000  # a tile of SRTM passes
MESHED_PIXELS = 1 << 14
SIDECARS = {"dem.prj": "dem.asc", "dem.pgm.msk": "dem.pgm", "dem.png.msk": "dem.png"}
KEPT_BYTES = 1 << 16  # larger mutants are not mutated further

NUMBERS = (0, 1, 2, 3, 7, 8, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63)
FLOATS = (0.0, -0.0, 1.0, 1e-320, 1e38, 3.5e38, 1e99, -1e308, float("inf"), float("nan"))
WORDS = (
    b"",
    b"0",
    b"-1",
    b"1",
    b"65536",
    b"2147483648",
    b"99999999999999999999",
    b"1e400",
    b"-1e-400",
    b"nan",
)
WORDS += (
    b"9" * 50,
    b"9" * 400,
    b"inf",
    b"1.5",
    b"1,5",
    b"0x10",
    b"\xc3\xa9",
    b"\0",
    b"%s%n",
    b" ",
    b"\n",
    b"&",
    b"<",
    b'"',
)


# The files to start from


def write_seeds(folder: Path) -> None:
    """Write small files of the formats that rasterio can make, and the corpus.

    No netCDF: its own library crashes on many damaged files, and nothing here could help that.
    """
    import rasterio
    from rasterio.control import GroundControlPoint
    from rasterio.shutil import copy
    from rasterio.transform import Affine

    heights = (500 + 10 * np.arange(6)[:, None] + 3 * np.arange(7)).astype("float32")

    def tiff(name: str, dtype: str = "float32", rows: int = 6, **profile: object) -> Path:
        values = {"crs": "EPSG:26710", "transform": Affine(30, 0, 557805, 0, -30, 5122005), **profile}
        with rasterio.open(
            folder / name, "w", driver="GTiff", dtype=dtype, count=1, width=7, height=rows, **values
        ) as dataset:
            dataset.write(np.resize(heights, (rows, 7)).astype(dtype), 1)
            if name == "scaled.tif":
                dataset.scales, dataset.offsets, dataset.units = (0.1,), (-3.0,), ("ft",)
            if name == "masked.tif":
                dataset.write_mask(heights > 520)
        return folder / name

    plain = tiff("dem.tif")
    tiff("scaled.tif", "int16", nodata=500, compress="deflate")
    tiff("tiled.tif", "float64", tiled=True, blockxsize=16, blockysize=16, compress="lzw", predictor=3)
    tiff("masked.tif", "uint8")
    tiff("huge.tif", "int32", BIGTIFF="YES")
    corners = [GroundControlPoint(row=r, col=c, x=10 + c, y=50 - r) for r, c in ((0, 0), (0, 7), (6, 0))]
    tiff("gcps.tif", gcps=corners, crs="EPSG:4326", transform=None)
    whole = tiff("whole.tif", "int16")
    degree = Affine(1 / 1200, 0, 7 - 1 / 2400, 0, -1 / 1200, 47 + 1 / 2400)
    tile = folder / "tile.tif"
    with rasterio.open(
        tile,
        "w",
        driver="GTiff",
        dtype="int16",
        count=1,
        width=1201,
        height=1201,
        crs="EPSG:4326",
        transform=degree,
    ) as dataset:
        dataset.write(np.resize(np.arange(7919), (1201, 1201)).astype("int16"), 1)
    for name, driver, source in (
        ("dem.asc", "AAIGrid", plain),
        ("dem.dem", "USGSDEM", whole),
        ("dem.gpkg", "GPKG", plain),
        ("dem.png", "PNG", folder / "masked.tif"),
        ("dem.pgm", "PNM", folder / "masked.tif"),
        ("dem.bmp", "BMP", folder / "masked.tif"),
        ("dem.grd", "GSBG", plain),
        ("dem.vrt", "VRT", plain),
        ("N46E007.hgt", "SRTMHGT", tile),
    ):
        copy(source, folder / name, driver=driver)
    for path in (tile, whole, *folder.glob("*.aux.xml")):
        path.unlink()
    for path in CORPUS.iterdir():
        shutil.copy(path, folder)
    (folder / "voids.asc.gz").write_bytes(gzip.compress((CORPUS / "voids.asc").read_bytes(), mtime=0))


# Mutation


def mutate(data: bytes, pool: list[tuple[str, bytes]], dice: random.Random) -> bytes:
    """Change a few places of ``data``."""
    made = bytearray(data)
    for _ in range(dice.choice((1, 1, 1, 2, 4, 8))):
        # Headers decide most: half of the changes fall into the first bytes.
        at = dice.randrange(min(len(made), dice.choice((64, 512, 1 << 30))) + 1)
        dice.choice((_bit, _number, _float, _word, _cut, _repeat, _splice))(made, at, pool, dice)
    return bytes(made)


def _bit(made: bytearray, at: int, _pool: object, dice: random.Random) -> None:
    if at < len(made):
        made[at] ^= 1 << dice.randrange(8)


def _number(made: bytearray, at: int, _pool: object, dice: random.Random) -> None:
    size = dice.choice((1, 2, 4, 8))
    number = (dice.choice(NUMBERS) + dice.randrange(-1, 2)) % 256**size
    made[at : at + size] = number.to_bytes(size, dice.choice(("little", "big")))


def _float(made: bytearray, at: int, _pool: object, dice: random.Random) -> None:
    kind = dice.choice(("<d", ">d", "<f", ">f"))
    value = dice.choice(FLOATS)
    if kind[1] == "f":
        value = float(np.clip(value, -3e38, 3e38))
    made[at : at + struct.calcsize(kind)] = struct.pack(kind, value)


def _word(made: bytearray, at: int, _pool: object, dice: random.Random) -> None:
    """Replace a number of a text, or a quoted word."""
    found = re.compile(rb"[-+.\w]+").search(made, at)
    if found and found.end() - found.start() < 64:
        made[found.start() : found.end()] = dice.choice(WORDS)


def _cut(made: bytearray, at: int, _pool: object, dice: random.Random) -> None:
    del made[at : at + dice.choice((1, 2, 8, 100, 1 << 30))]


def _repeat(made: bytearray, at: int, _pool: object, dice: random.Random) -> None:
    made[at:at] = made[at : at + dice.choice((1, 4, 16, 100))] * dice.choice((1, 2, 50))


def _splice(made: bytearray, at: int, pool: list[tuple[str, bytes]], dice: random.Random) -> None:
    other = dice.choice(pool)[1]
    start, size = dice.randrange(len(other) + 1), dice.choice((2, 16, 128))
    made[at : at + size] = other[start : start + size]


# The process that may crash


def attempt(path: str) -> tuple[str, str]:
    """Open a file and mesh it; "ok", the code or "found", and what tells the outcome from others."""
    import tin

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            dem = tin.open(path, max_pixels=MAX_PIXELS)
            if dem.rows * dem.cols <= MESHED_PIXELS:
                tin.triangulate(dem, max_points=20)
    except tin.TinError as error:
        if error.code and str(error) and "\n" not in str(error):
            return error.code, re.sub(r"\d+", "#", str(error).replace(path, ""))[:80]
        return "found", f"an error without a code or one line: {error.code!r} {str(error)!r}"
    except BaseException:  # noqa: BLE001 - whatever else comes out is what is looked for
        return "found", traceback.format_exc()
    return "ok", f"{dem.shape} {dem.z.dtype} {dem.crs} {dem.vertical_unit} {dem.n_valid}"


def worker(connection: multiprocessing.connection.Connection, log: str) -> None:
    """Answer paths with what came of them until the parent is gone."""
    with Path(log).open("wb") as file:
        os.dup2(file.fileno(), 2)  # GDAL writes there, too
    faulthandler.enable()
    logging.disable()
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    except ImportError:
        pass  # Windows has no such limit
    while True:
        try:
            path = connection.recv()
        except EOFError:
            return
        # Where it hangs is told just before the parent gives up.
        faulthandler.dump_traceback_later(LIMIT_S - 1)
        connection.send(attempt(path))
        faulthandler.cancel_dump_traceback_later()


class Reader:
    """A worker process, started anew after each crash or hang."""

    def __init__(self, folder: Path) -> None:
        self.log = folder / "stderr"
        self.process: multiprocessing.process.BaseProcess | None = None

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=worker, args=(theirs, str(self.log)), daemon=True)
        self.process.start()
        theirs.close()
        # The libraries are loaded before the clock runs.
        self.connection.send(str(CORPUS / "plain.pgm"))
        self.connection.recv()

    def stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None

    def read(self, path: Path) -> tuple[str, str]:
        """As `attempt`, and "found" for a crash or a hang."""
        if self.process is None:
            self.start()
        try:
            self.connection.send(str(path))
            if self.connection.poll(LIMIT_S):
                return self.connection.recv()
            why = f"a hang of more than {LIMIT_S} s"
        except (EOFError, ConnectionError):
            self.process.join()
            why = f"a crash, exit code {self.process.exitcode}"
        self.stop()
        return "found", f"{self.log.read_text(errors='replace')[-4000:]}\n{why}"


def place_of(why: str) -> str:
    """What tells a finding from another one: the error's type and the last line of ours it came by."""
    lines = re.findall(r'File ".*?((?:tin|core)[/\\][^/\\]+\.py", line \d+)', why)
    return f"{lines[-1] if lines else ''} {why.strip().splitlines()[-1][:60]}"


def fuzz(seconds: float, seed: int, found: Path, folder: Path) -> int:
    """Open mutants for a while; the number of different findings."""
    dice = random.Random(seed)
    seeds, work = folder / "seeds", folder / "work"
    seeds.mkdir()
    write_seeds(seeds)
    shutil.copytree(seeds, work)
    pool = [(path.name, path.read_bytes()) for path in sorted(seeds.iterdir())]
    firsts = len(pool)
    counts: collections.Counter[str] = collections.Counter()
    outcomes, findings = set(), set()
    reader = Reader(folder)
    # Each file as it is, then mutants of these and of what they led to.
    unchanged = iter(pool[:])
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        name, data = next(unchanged, ("", b""))
        is_mutant = not name
        if is_mutant:
            name, data = dice.choice(dice.choice((pool, pool[:firsts])))
            data = mutate(data, pool, dice)
        path = work / name
        path.write_bytes(data)
        code, why = reader.read(work / SIDECARS.get(name, name))
        counts[code] += 1
        is_new = is_mutant and (name, code, why) not in outcomes
        if code == "found" and place_of(why) not in findings:
            findings.add(place_of(why))
            kept = found / f"{seed}-{len(findings)}"
            # With what lies beside it: a VRT names other files.
            shutil.copytree(work, kept, dirs_exist_ok=True)
            print(f"{kept / SIDECARS.get(name, name)}: {why}\n", flush=True)
        elif code != "found" and is_new and len(data) <= KEPT_BYTES:
            # An outcome not seen before is worth going on from.
            outcomes.add((name, code, why))
            pool.append((name, data))
        shutil.copy(seeds / name, path)
    reader.stop()
    print(f"{sum(counts.values())} files, {len(outcomes)} outcomes:", dict(counts.most_common()))
    return len(findings)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path, help="try these once instead")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=random.randrange(2**32))
    parser.add_argument(
        "--found", type=Path, default=Path("target/fuzz/found/reader"), help="where findings go"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.files:
            reader = Reader(folder)
            results = [(path, *reader.read(path)) for path in options.files]
            reader.stop()
            print(*(f"{path}: {code} {why}" for path, code, why in results), sep="\n")
            return int(any(code == "found" for _, code, _ in results))
        print(f"seed {options.seed}", flush=True)
        return int(fuzz(options.seconds, options.seed, options.found, folder) > 0)


if __name__ == "__main__":
    sys.exit(main())
