"""The ``dem2tin`` command."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

from tin import __version__, options
from tin.errors import Cancelled, InputError, OptionError, OutputError, TinError

EXIT_CODES = ((OptionError, 2), (InputError, 3), (OutputError, 4), (Cancelled, 130))
GROUPS = (
    ("method", "triangulation"),
    ("constraints", "what the TIN follows"),
    ("input", "reading"),
    ("output", "writing"),
)
BAR_WIDTH = 30

DESCRIPTION = "Turn a DEM into a compact TIN that stays true to the terrain even where the DEM is noisy."
EPILOG = """\
OUTPUT is chosen by its suffix:
  .gpkg  POLYGON Z features      .tif  the TIN rasterised on the DEM's grid
  .obj   3D mesh                 .nc   mesh layer for QGIS (UGRID)
  .png   picture of the TIN and its errors

examples:
  dem2tin sthelens.dem tin.gpkg
  dem2tin tile.tif tin.gpkg tin.obj tin.tif --max-points 2%
  dem2tin tile.tif tin.gpkg --tolerance 0.5 --json report.json
"""


class Parser(argparse.ArgumentParser):
    """Reports a wrong command line in one line."""

    def error(self, message: str) -> Any:
        """Raise instead of exiting."""
        raise OptionError("usage", f"{message} (see {self.prog} --help)")


def parser() -> argparse.ArgumentParser:
    """The command line, made from ``tin.options``."""
    made = Parser(
        "dem2tin",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    made.add_argument("dem", metavar="DEM", help="raster of heights, in any format that GDAL reads")
    made.add_argument("outputs", metavar="OUTPUT", nargs="+", help="files to write")
    for group, title in GROUPS:
        section = made.add_argument_group(title)
        for option in options.of_group(group):
            _add(section, option)
    section = made.add_argument_group("the run")
    section.add_argument("--overwrite", action="store_true", help="replace outputs that exist")
    section.add_argument("--quiet", action="store_true", help="no progress and no report")
    section.add_argument("--json", metavar="FILE|-", help="write the report as JSON, - for standard output")
    section.add_argument("--error-map", metavar="FILE.tif", help="write the signed errors, TIN less DEM")
    text = "write the outline of the TIN as polygons, for clipping"
    section.add_argument("--outline", metavar="FILE.gpkg", help=text)
    section.add_argument("--version", action="version", version=f"dem2tin {__version__}")
    return made


def _add(section: Any, option: options.Option) -> None:
    notes = [option.unit] if option.unit else []
    if option.default is not None and not option.is_flag:
        notes.append(f"default: {option.default}")
    text = f"{option.help} [{'; '.join(notes)}]" if notes else option.help
    settings: dict[str, Any] = {"dest": option.name, "default": None, "help": text.replace("%", "%%")}
    if option.is_flag:
        switchable = option.default is None
        action: Any = argparse.BooleanOptionalAction if switchable else "store_true"
        section.add_argument(option.flag, action=action, **settings)
    else:
        shown = "|".join(option.choices) or option.metavar
        section.add_argument(option.flag, metavar=shown, **settings)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code: 0 done, 2 usage, 3 input, 4 output, 130 interrupted."""
    # A polite kill is treated like Ctrl-C, so that nothing half-written stays behind.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        run(parser().parse_args(arguments))
        sys.stdout.flush()
    except TinError as error:
        return _fail(str(error), next(code for kind, code in EXIT_CODES if isinstance(error, kind)))
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except MemoryError:
        return _fail("not enough memory for this DEM", 3)
    except OSError as error:
        # What the library writes raises OutputError: this is the report on its way out.
        sys.stdout = None  # type: ignore[assignment]
        return _fail(str(error), 4)
    return 0


def _fail(message: str, code: int) -> int:
    print(f"dem2tin: {' '.join(message.split())}", file=sys.stderr)
    return code


def run(given: argparse.Namespace) -> None:
    """Read, triangulate, write and report."""
    from tin import formats, reader, transform, units
    from tin.formats.atomic import Batch
    from tin.tin import triangulate

    start = time.perf_counter()
    # In MB. What GDAL keeps of the DEM is not read again; by itself it would keep 5 % of the memory.
    os.environ.setdefault("GDAL_CACHEMAX", "64")
    values = vars(given)
    inputs, method, followed, output = (
        {option.name: values[option.name] for option in options.of_group(group)}
        for group in ("input", "method", "constraints", "output")
    )
    reading, writing = options.parse(inputs, "input"), options.parse(output, "output")
    following = options.parse(followed, "constraints")
    options.parse_method(method)
    vectors = [following[name] for name in ("breaklines", "points", "clip", "flat") if following[name]]
    report = None if given.json in (None, "-") else given.json
    formats.check_outputs(
        given.outputs,
        overwrite=given.overwrite,
        inputs=[file for source in (given.dem, *vectors) for file in reader.source_files(source)],
        report=report,
        error_map=given.error_map,
        outline=given.outline,
    )
    bar = Bar(sys.stderr, quiet=given.quiet)
    bar("read", 0.0)
    dem = reader.open(given.dem, **reading)
    to_crs = writing.pop("to_crs")
    # What cannot be done is said before the work.
    crs = None if to_crs is None else transform.target(dem, to_crs)
    mesh = triangulate(dem, progress=bar, allow_remote=reading["allow_remote"], **following, **method)
    if crs is not None:
        bar("reproject", 0.0)
        mesh = mesh.to_crs(crs)
    warnings = mesh.report.warnings
    if any(map(formats.is_3d, given.outputs)):
        message = units.warning(mesh.crs, dem.vertical_unit, reading["z_factor"])
        warnings = [*warnings, *([] if message is None else [message])]
    with Batch() as batch:
        safely: dict[str, Any] = {"overwrite": given.overwrite, "batch": batch}
        for path in given.outputs:
            bar(f"write {Path(path).name}", 0.0)
            formats.write(mesh, path, **safely, **formats.accepted(path, writing))
        if given.error_map:
            formats.write_error_map(mesh, given.error_map, **safely)
        if given.outline:
            formats.write_outline(mesh, given.outline, **safely)
        result = replace(mesh.report, seconds=time.perf_counter() - start, warnings=warnings)
        numbers = json.dumps(result.to_dict(), indent=2)
        if report:
            formats.write_text(report, numbers + "\n", **safely)
    bar.close()
    if given.json == "-":
        print(numbers)
    if not given.quiet:
        for warning in warnings:
            print(f"dem2tin: warning: {warning}", file=sys.stderr)
        print(result, file=sys.stderr if given.json == "-" else sys.stdout)


class Bar:
    """Progress on a terminal; called with (stage, fraction)."""

    def __init__(self, stream: TextIO, *, quiet: bool) -> None:
        self.stream = stream
        self.is_shown = not quiet and stream.isatty()

    def __call__(self, stage: str, fraction: float) -> bool:
        """Redraw the bar; never cancels."""
        if self.is_shown:
            done = round(BAR_WIDTH * fraction)
            self.stream.write(f"\r\x1b[K{stage:<12} [{'#' * done}{'.' * (BAR_WIDTH - done)}] {fraction:4.0%}")
            self.stream.flush()
        return True

    def close(self) -> None:
        """Clear the line."""
        if self.is_shown:
            self.stream.write("\r\x1b[K")
            self.stream.flush()
