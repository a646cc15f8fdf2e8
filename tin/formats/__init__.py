"""The file formats a TIN can be written to, chosen by the suffix of the file's name."""

from __future__ import annotations

import importlib
import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Union

from tin.errors import OptionError, OutputError
from tin.formats import geotiff, gpkg, obj, png, ugrid
from tin.formats.atomic import Batch, atomic, check_writable, refuse_existing

if TYPE_CHECKING:
    from tin.tin import Tin

StrPath = Union[str, "os.PathLike[str]"]


class Writer(NamedTuple):
    """How one format is written."""

    write: Callable[..., None]
    """``write(tin, path, **options)``: writes ``path``, and files beside it; raises OSError on failure."""
    library: str
    """The library that ``write`` imports."""
    companions: tuple[str, ...]
    """Patterns of the names of files that belong to an output of this name and stem."""
    is_3d: bool = False
    """Whether what opens it shows x, y and z to one scale."""


_TIFF = Writer(geotiff.write, "rasterio", ("{name}.aux.xml", "{name}.ovr", "{name}.msk"))

WRITERS: dict[str, Writer] = {
    ".gpkg": Writer(gpkg.write, "pyogrio", ("{name}-wal", "{name}-shm", "{name}-journal")),
    ".obj": Writer(obj.write, "numpy", ("{stem}.prj",), is_3d=True),
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".nc": Writer(ugrid.write, "numpy", ("{name}.aux.xml",), is_3d=True),
    ".png": Writer(png.write, "matplotlib", ("{name}.aux.xml",)),
}

ERROR_WRITERS = {suffix: _TIFF._replace(write=geotiff.write_error) for suffix in (".tif", ".tiff")}
"""The formats of an error map."""

OUTLINE_WRITERS = {".gpkg": WRITERS[".gpkg"]._replace(write=gpkg.write_outline)}
"""The formats of an outline."""


def write(
    tin: Tin, path: StrPath, *, overwrite: bool = False, batch: Batch | None = None, **options: Any
) -> None:
    """Write ``tin`` to ``path`` in the format of its suffix; all of it, or nothing.

    ``options`` are those of the format (``y_up=True`` for OBJ). With a ``batch`` the file appears when
    that is left, together with all others in it.

    Raises OutputError: ``unknown-suffix``, ``no-directory``, ``not-writable``, ``exists``,
    ``missing-library``, ``write-failed``; OptionError: ``unknown-option``.
    """
    target = _real(path)
    writer = _writer(target)
    unknown = sorted(options.keys() - accepted(target, options).keys())
    if unknown:
        raise OptionError("unknown-option", f"{target}: {target.suffix} has no option {', '.join(unknown)}")
    companions = _companions(writer, target)
    with atomic(target, overwrite=overwrite, companions=companions, batch=batch) as private:
        writer.write(tin, private, **options)


def write_error_map(tin: Tin, path: StrPath, *, overwrite: bool = False, batch: Batch | None = None) -> None:
    """Write the signed error of ``tin``, TIN less DEM, as a GeoTIFF on the grid that ``write`` uses for .tif.

    Raises OutputError, as ``write`` does.
    """
    _write_with(ERROR_WRITERS, tin, path, overwrite, batch)


def write_outline(tin: Tin, path: StrPath, *, overwrite: bool = False, batch: Batch | None = None) -> None:
    """Write the area that ``tin`` covers as a GeoPackage of polygons, one for each part; see ``Tin.outline``.

    Raises OutputError, as ``write`` does.
    """
    _write_with(OUTLINE_WRITERS, tin, path, overwrite, batch)


def _write_with(
    writers: Mapping[str, Writer], tin: Tin, path: StrPath, overwrite: bool, batch: Batch | None
) -> None:
    target = _real(path)
    writer = _writer(target, writers)
    companions = _companions(writer, target)
    with atomic(target, overwrite=overwrite, companions=companions, batch=batch) as private:
        writer.write(tin, private)


def write_text(path: StrPath, text: str, *, overwrite: bool = False, batch: Batch | None = None) -> None:
    """Write a report or the like as UTF-8, with the same care and the same errors."""
    with atomic(_real(path), overwrite=overwrite, batch=batch) as private:
        private.write_text(text, encoding="utf-8")


def accepted(path: StrPath, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of ``options`` that the format of ``path`` has."""
    known = inspect.signature(_writer(_real(path)).write).parameters
    return {name: value for name, value in options.items() if name in known}


def is_3d(path: StrPath) -> bool:
    """Return whether the format of ``path`` is one that shows x, y and z to one scale."""
    return _writer(_real(path)).is_3d


def check_outputs(
    paths: Iterable[StrPath],
    *,
    overwrite: bool = False,
    inputs: Iterable[StrPath] = (),
    report: StrPath | None = None,
    error_map: StrPath | None = None,
    outline: StrPath | None = None,
) -> None:
    """Refuse before any work is done what could not be written in the end.

    ``inputs`` are the files read: neither they nor their ``.prj`` may be overwritten.
    ``report`` is a text to be written beside the TIN, under any suffix; ``error_map`` is for
    ``write_error_map``, ``outline`` for ``write_outline``.

    Raises OutputError: ``unknown-suffix``, ``missing-library``, ``no-directory``, ``not-writable``,
    ``exists``, ``same-as-input``, ``duplicate-output``.
    """
    sources = {_real(path) for path in inputs}
    seen: set[Path] = set()
    targets = [(target, _companions(_writer(target), target)) for target in map(_real, paths)]
    for path, writers in ((error_map, ERROR_WRITERS), (outline, OUTLINE_WRITERS)):
        if path is not None:
            target = _real(path)
            targets.append((target, _companions(_writer(target, writers), target)))
    if report is not None:
        targets.append((_real(report), []))
    for target, companions in targets:
        if target in seen:
            raise OutputError("duplicate-output", f"{target}: named twice as an output")
        seen.add(target)
        for path in (target, *companions):
            if path in sources or _belongs_to(path, target, sources):
                raise OutputError("same-as-input", f"{path}: belongs to the input; choose another name")
        refuse_existing(target, companions, overwrite=overwrite)
        check_writable(target)


def _real(path: StrPath) -> Path:
    # Through symbolic links, so that the file they name is replaced and not the link.
    return Path(os.path.realpath(path))


def _writer(target: Path, writers: Mapping[str, Writer] = WRITERS) -> Writer:
    writer = writers.get(target.suffix.lower())
    if writer is None:
        known = ", ".join(writers)
        raise OutputError("unknown-suffix", f"{target}: unknown suffix '{target.suffix}'; known are {known}")
    try:
        importlib.import_module(writer.library)
    except ImportError as error:
        message = (
            f"{target}: writing {target.suffix} needs {writer.library} ({error}): install {writer.library}"
        )
        raise OutputError("missing-library", message) from error
    return writer


def _companions(writer: Writer, target: Path) -> list[Path]:
    names = (pattern.format(name=target.name, stem=target.stem) for pattern in writer.companions)
    return [target.with_name(name) for name in names]


def _belongs_to(path: Path, target: Path, sources: set[Path]) -> bool:
    """Whether ``path``, an existing file beside ``target``, describes a source of the same stem."""
    shared = not path.name.startswith(target.name) and path.exists()
    return shared and any(path == source.with_suffix(path.suffix) for source in sources)
