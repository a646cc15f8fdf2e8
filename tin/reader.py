"""Opening a DEM from a file: what GDAL reads through rasterio, and plain height images."""

from __future__ import annotations

import importlib
import os
import re
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tin import sources
from tin.dem import DEM
from tin.errors import InputError
from tin.sources import Array, Source

_REMOTE = re.compile(
    r"\b(https?|ftps?|s3a?|gs|az|azure|adls?|abfss?|oss|swift|hdfs|webhdfs)://"
    r"|/vsi(curl|s3|gs|az|adls|oss|swift|hdfs|webhdfs)\b|/vsi\w+_streaming"
    r"|^(WMS|WCS|WMTS|EEDAI?|PLMosaic|DAAS|OGCAPI|STACI?TA?|NGW|HTTP):",
    re.IGNORECASE,
)
_GDAL_NAME = re.compile(r"/vsi|\w{2,}:")
_XML_DATASET = re.compile(rb"(\xef\xbb\xbf)?\s*(<[^\0]*)?<(VRT|OGRVRT|GDAL|WMS_|WCS_)")
_OIIO_TYPES = {"half": "float16", "float": "float32", "double": "float64", "uint": "uint32"}
# Elements of a VRT whose text may hold an address without naming a source.
_XML_PROSE = {"SRS", "MDI", "Metadata", "Description", "TargetSRS", "SourceSRS"}


def open(
    path: str | os.PathLike[str],
    *,
    band: int = 1,
    z_factor: float = 1.0,
    max_pixels: int = 2**31,
    allow_remote: bool = False,
) -> DEM:
    """Read one band of a raster file as a DEM.

    Everything that rasterio's GDAL reads is understood (also gzipped, ``x.dem.gz``), and plain height
    images that it does not read: plain-text PGM, EXR, PFM. An image without georeference gets unit pixels
    and no CRS.

    Args:
        path: a file, or a GDAL dataset name such as ``netcdf:x.nc:z``.
        band: counted from 1.
        z_factor: every height is multiplied by it, see `DEM.scaled`.
        max_pixels: a raster with more pixels is refused from its header, before any memory is taken.
        allow_remote: also read from the network, be it by `path` or by what a VRT names.

    Raises:
        InputError: "not-found", "not-a-raster", "is-vector", "unreadable", "remote", "missing-library",
            and the codes of `DEM.from_rasterio`.
    """
    name = os.fspath(path)
    if not allow_remote and is_remote(name):
        raise _remote(name, "is remote")
    head = _head(name)
    if not allow_remote and head:
        _check_sources(Path(name), name, set())
    if re.match(rb"P2[\s#]", head):
        return DEM._load(_plain_pgm(name, band, max_pixels), z_factor, max_pixels)
    rasterio = _library("rasterio", name)
    settings = {"CPL_VSIL_GZIP_WRITE_PROPERTIES": "NO"}  # nothing is written beside the user's file
    if not allow_remote:
        settings["CPL_VSIL_CURL_ALLOWED_FILENAME"] = "-"  # a second lock, for what the check did not see
    # rasterio compares a NoData value beyond float32 in float32, and numpy warns.
    with rasterio.Env(**settings), np.errstate(over="ignore"):
        try:
            dataset = _open_dataset(rasterio, name, is_gzip=head[:2] == b"\x1f\x8b")
        except (OSError, UnicodeError) as error:
            why = sources.reason(error)
            if "not recognized as being in a supported file format" in why:
                return DEM._load(_image(name, band, max_pixels), z_factor, max_pixels)
            code = "too-large" if "too large" in why.lower() else "unreadable"
            raise InputError(code, f"{name}: cannot be read ({why})") from error
        with dataset:
            return DEM.from_rasterio(dataset, band, z_factor, max_pixels)


def source_files(name: str) -> list[Path]:
    """The existing files that a file, dataset or layer name stands for, for example ``netcdf:x.nc:z``.

    Those a VRT names are among them, the archive of ``/vsizip/x.zip/y.tif``, and all files of a shapefile.
    """
    names = {
        name,
        *name.replace('"', "").split(":"),
        re.sub(r"^(/vsi\w+/)+", "", name),
        name.rpartition(":")[0],
    }
    for part in list(names):
        names.update(str(folder) for folder in Path(part).parents)
        if part.lower().endswith(".shp"):
            names.update(part[:-4] + suffix for suffix in (".shx", ".dbf", ".prj", ".cpg"))
    try:
        import rasterio

        refuse_remote(name)
        with warnings.catch_warnings(), rasterio.Env(CPL_VSIL_CURL_ALLOWED_FILENAME="-"):
            warnings.simplefilter("ignore")
            with rasterio.open(name) as dataset:
                names.update(dataset.files)
    except Exception:  # noqa: BLE001 - whatever is wrong with the file, reading it will say so
        names.discard("")
    return [Path(part) for part in sorted(names) if part and _is_file(Path(part))]


def is_remote(name: str) -> bool:
    """Whether a file or GDAL dataset name leads to the network."""
    return _REMOTE.search(name) is not None


def refuse_remote(name: str) -> None:
    """Raise InputError ("remote") for a name that leads to the network, and for a VRT that does."""
    if is_remote(name):
        raise _remote(name, "is remote")
    _check_sources(Path(name), name, set())


def _head(name: str) -> bytes:
    """Return the first bytes of a local file, none of a folder or of a GDAL dataset name that is no file."""
    path = Path(name)
    try:
        if path.is_file():
            with path.open("rb") as file:
                return file.read(4096)
        if (name and path.is_dir()) or (_GDAL_NAME.match(name) and not path.exists()):
            return b""
        found = path.exists()
    except (OSError, ValueError) as error:
        raise InputError("unreadable", f"{name!r}: cannot be read ({error})") from error
    if found:
        raise InputError("not-a-raster", f"{name}: not a regular file")
    raise InputError("not-found", f"{name}: no such file")


def _remote(name: str, what: str) -> InputError:
    return InputError("remote", f"{name}: {what}; download it first, or allow remote sources (allow_remote)")


def _check_sources(path: Path, name: str, seen: set[Path]) -> None:
    """Refuse a VRT, or other XML that describes a dataset, where it leads to the network, also by others."""
    if path in seen or not _is_file(path):
        return
    seen.add(path)
    with path.open("rb") as file:
        if not _XML_DATASET.match(file.read(4096)):
            return
    try:
        texts = [(e.text or "").strip() for e in ElementTree.parse(path).iter() if e.tag not in _XML_PROSE]
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError("unreadable", f"{path}: broken XML ({error})") from error
    for text in filter(None, texts):
        if _REMOTE.search(text):
            raise _remote(name, f"{path} names the remote source {text}")
        _check_sources(path.parent / text, name, seen)
        _check_sources(Path(text), name, seen)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a text too long for a file name
        return False


def _open_dataset(rasterio: Any, name: str, *, is_gzip: bool) -> Any:
    target = f"/vsigzip/{Path(name).resolve()}" if is_gzip and name.lower().endswith(".gz") else name
    # A DEM without georeference is no reason to warn.
    with sources.WARNING_FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        return rasterio.open(target)


def _plain_pgm(name: str, band: int, max_pixels: int) -> Source:
    """Read a plain-text PGM: GDAL takes it for a list of points, and OpenImageIO rescales and clips it."""
    data = re.sub(rb"#[^\r\n]*", b"", Path(name).read_bytes())
    header = re.match(rb"P2\s+(\d{1,10})\s+(\d{1,10})\s+(\d{1,10})(?=\s|$)", data)
    if header is None:
        raise InputError(
            "unreadable", f"{name}: not a plain PGM, its header must be: P2 width height maximum"
        )
    cols, rows, maximum = map(int, header.groups())
    sources.check_size(rows, cols, max_pixels, name)
    sources.check_band(name, band, 1)

    def pixels(dtype: str) -> Array:
        # Two characters a number at least, so a header cannot make a small file ask for much memory.
        if len(data) - header.end() < 2 * rows * cols:
            raise OSError(f"cut short, it should hold {rows * cols} heights")
        numbers = (int(token[0]) for token in re.finditer(rb"\S+", data[header.end() :]))
        try:
            with np.errstate(over="ignore"):
                heights = np.fromiter(numbers, dtype, rows * cols)
        except (ValueError, OverflowError) as error:
            raise OSError(f"it should hold {rows * cols} whole numbers") from error
        if heights.min() < 0 or heights.max() > maximum:
            raise OSError(f"its heights should be between 0 and {maximum}")
        return heights.reshape(rows, cols)

    dtype = "uint16" if maximum < 2**16 else "uint64"
    return Source(name, sources.stem(name), rows, cols, dtype, pixels)


def _image(name: str, band: int, max_pixels: int) -> Source:
    """Describe a plain image that GDAL does not know, such as EXR, through OpenImageIO."""
    oiio = _library("OpenImageIO", name)
    settings = oiio.ImageSpec()
    settings.attribute("pnm:pfmflip", 1)  # a PFM is stored from the bottom up
    image = oiio.ImageInput.open(name, settings) if Path(name).is_file() else None
    # An error that nobody asks for is printed by OpenImageIO at exit.
    why = oiio.geterror()
    if image is None:
        if _is_vector(name):
            raise InputError("is-vector", f"{name}: a vector file; a DEM must be a raster")
        raise InputError(
            "not-a-raster", f"{name}: not a raster in any known format ({' '.join(why.split())})"
        )
    spec = image.spec()
    sources.check_band(name, band, spec.nchannels)
    sources.check_size(spec.height, spec.width, max_pixels, name)

    def channel(index: int, dtype: str) -> Array:
        # In the file's own format: any other would rescale integers to 0..1.
        values = image.read_image(0, 0, index, index + 1, spec.format)
        if values is None:
            raise OSError(image.geterror())
        return np.array(values, dtype=dtype).reshape(spec.height, spec.width)

    alpha = spec.alpha_channel
    return Source(
        label=name,
        name=sources.stem(name),
        rows=spec.height,
        cols=spec.width,
        dtype=_OIIO_TYPES.get(str(spec.format), str(spec.format)),
        pixels=lambda dtype: channel(band - 1, dtype),
        mask=None if alpha in (-1, band - 1) else lambda: channel(alpha, "float32"),
    )


def _is_vector(name: str) -> bool:
    try:
        import fiona

        return bool(fiona.listlayers(name))
    except Exception:  # any failure at all means that this is no vector file we could name
        return False


def _library(library: str, name: str) -> Any:
    try:
        return importlib.import_module(library)
    except ImportError as error:
        raise InputError("missing-library", f"{name} needs {library}: pip install {library}") from error
