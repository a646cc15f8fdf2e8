"""Every option of dem2tin, once: name, meaning, unit, bounds and default.

The command line, the Python keywords and the QGIS parameters are all made from
``OPTIONS``; the methods are nothing but settings of the same options.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tin import values
from tin.errors import OptionError
from tin.values import ALL_CPUS, MIN_POINTS, NOISE_STOP, Distance, Share

if TYPE_CHECKING:
    from tin.dem import DEM


@dataclass(frozen=True)
class Option:
    """One option. ``parse`` turns text or a Python value into what the core needs, or raises ValueError."""

    name: str
    parse: Callable[[Any], Any]
    help: str
    default: Any = None
    metavar: str = ""
    choices: tuple[str, ...] = ()
    unit: str = ""
    group: str = "method"
    advanced: bool = False
    is_flag: bool = field(default=False)

    @property
    def flag(self) -> str:
        """The name on the command line."""
        return "--" + self.name.replace("_", "-")

    def read(self, value: Any) -> Any:
        """The parsed value; raises OptionError ``bad-option``."""
        try:
            return self.parse(value)
        except (TypeError, ValueError, OverflowError) as error:
            reason = str(error) or f"not understood: {value!r}"
            raise OptionError("bad-option", f"{self.flag}: {reason}") from error


def _method(value: Any) -> str:
    name = str(value).strip().lower()
    if name not in METHODS:
        raise ValueError(f"{value!r} is none of {', '.join(METHODS)}")
    return name


METHODS: Mapping[str, Mapping[str, Any]] = {
    "auto": {
        "metric": 0.5,
        "weight": 0.25,
        "candidate": 1.0,
        "scales": "auto",
        "despike": True,
        "fit": True,
        "flips": 2,
    },
    "median": {
        "metric": 0.5,
        "weight": 0.0,
        "candidate": 0.5,
        "scales": "0.8px,0.7px,0.55px,0.45px",
        "despike": False,
        "fit": False,
        "flips": 0,
    },
    "max": {
        "metric": 1.0,
        "weight": 0.0,
        "candidate": 1.0,
        "scales": "0px",
        "despike": False,
        "fit": False,
        "flips": 0,
    },
}
"""What each method sets; an option given by the user overrides it."""

OPTIONS: tuple[Option, ...] = (
    Option(
        "max_points",
        values.points,
        "stop at N vertices, at P percent of the valid pixels, or (auto) where more would only fit the noise "
        "(default: 5%, or no limit with a tolerance)",
        metavar="N|P%|auto",
    ),
    Option(
        "tolerance",
        values.real,
        "stop when the error metric is at most Z in every triangle; with the methods auto and max no "
        "pixel is then farther than Z from the TIN",
        metavar="Z",
        unit="vertical unit of the DEM",
    ),
    Option(
        "method",
        _method,
        "auto: robust against noise and the most accurate; median: da Silva et al. (2011); "
        "max: Garland and Heckbert (1995)",
        default="auto",
        choices=tuple(METHODS),
    ),
    Option(
        "metric",
        values.quantile,
        "quantile of a triangle's errors that ranks it: median, max or a number above 0 up to 1",
        metavar="median|max|Q",
        advanced=True,
    ),
    Option(
        "weight",
        lambda value: values.real(value, 0.0, 4.0),
        "a triangle's rank is multiplied by its number of pixels to this power",
        metavar="A",
        advanced=True,
    ),
    Option(
        "candidate",
        values.quantile,
        "quantile of a triangle's errors at which the pixel to insert stands",
        metavar="median|max|Q",
        advanced=True,
    ),
    Option(
        "scales",
        values.scales,
        "standard deviations of the Gaussian smoothing, coarse to fine, or auto; 0 is the DEM itself",
        metavar="S,S,...",
        unit="ground units of the CRS (metres where it is geographic), or pixels with the suffix px",
        advanced=True,
    ),
    Option(
        "points_per_scale",
        lambda value: values.whole(value, 1, values.MAX_POINTS),
        "new vertices at most in each scale (default: an even share of the points)",
        metavar="M",
        advanced=True,
    ),
    Option(
        "despike",
        values.switch,
        "replace single pixels that stand out of their neighbours",
        is_flag=True,
        advanced=True,
    ),
    Option(
        "fit", values.switch, "fit the heights of the vertices by least squares", is_flag=True, advanced=True
    ),
    Option(
        "flips",
        lambda value: values.whole(value, 0, 100),
        "rounds of edge flips that lower the squared error; the TIN is then not Delaunay",
        metavar="K",
        advanced=True,
    ),
    Option(
        "outline_tolerance",
        values.distance,
        "distance by which the outline of the data may take in void; data are never cut off",
        default=Distance(1.0, in_pixels=True),
        metavar="D",
        unit="ground units of the CRS (metres where it is geographic), or pixels with the suffix px",
        group="method",
        advanced=True,
    ),
    Option(
        "keep_isolated",
        values.switch,
        "give single pixels and lines one pixel wide a small area, so that they are in the TIN",
        default=False,
        is_flag=True,
        advanced=True,
    ),
    Option(
        "sieve",
        lambda value: values.whole(value, 0, values.MAX_POINTS),
        "leave out islands of fewer pixels, and fill holes of fewer",
        default=0,
        metavar="PIXELS",
        advanced=True,
    ),
    Option(
        "tile",
        values.tile,
        "refine large DEMs in tiles of this side in pixels, with seams that the TIN does not show; 0: in one "
        "piece",
        default=384,
        metavar="PIXELS",
        advanced=True,
    ),
    Option(
        "threads",
        values.threads,
        "run on N threads, or (auto) on as many as this process may use CPUs; the TIN is the same, "
        "byte for byte",
        default=ALL_CPUS,
        metavar="N|auto",
        advanced=True,
    ),
    Option(
        "breaklines",
        values.layer,
        "vector file of lines that become edges of the TIN; lines with heights keep them, the others take "
        "those of the DEM",
        metavar="FILE[:LAYER]",
        group="constraints",
    ),
    Option(
        "points",
        values.layer,
        "vector file of points that are vertices from the start; points with heights keep place and height",
        metavar="FILE[:LAYER]",
        group="constraints",
    ),
    Option(
        "clip",
        values.layer,
        "vector file of polygons: what lies outside is left out",
        metavar="FILE[:LAYER]",
        group="constraints",
    ),
    Option(
        "flat",
        values.layer,
        "vector file of polygons, such as lakes, that are kept level: at their own height, or at the DEM's "
        "median there",
        metavar="FILE[:LAYER]",
        group="constraints",
    ),
    Option(
        "soft",
        values.switch,
        "ignore the heights of breaklines and points",
        default=False,
        group="constraints",
        is_flag=True,
    ),
    Option(
        "band", lambda value: values.whole(value, 1), "band to read", default=1, metavar="B", group="input"
    ),
    Option(
        "z_factor",
        values.factor,
        "multiply the heights while reading, for example 0.3048 for feet to metres",
        default=1.0,
        metavar="F",
        group="input",
    ),
    Option(
        "allow_remote",
        values.switch,
        "also read files from the network",
        default=False,
        group="input",
        is_flag=True,
        advanced=True,
    ),
    Option(
        "to_crs",
        values.crs,
        "put the TIN into another CRS, or (utm) into the UTM zone of the DEM's centre; heights stay",
        metavar="EPSG:N|utm",
        group="output",
    ),
    Option(
        "y_up",
        values.switch,
        "OBJ with y upwards (x east, z south), as games expect it",
        default=False,
        group="output",
        is_flag=True,
    ),
)
"""All options; those of the groups "method" and "constraints" are keywords of ``tin.triangulate``."""

BY_NAME: Mapping[str, Option] = {option.name: option for option in OPTIONS}
DEFAULT_POINTS = Share(5.0)


def of_group(group: str) -> list[Option]:
    """The options for reading ("input"), triangulating ("method", "constraints") or writing ("output")."""
    return [option for option in OPTIONS if option.group == group]


def parse(values: Mapping[str, Any], group: str) -> dict[str, Any]:
    """The options of ``group`` with every value given (not None) parsed, else the default.

    Raises OptionError: ``unknown-option``, ``bad-option``.
    """
    known = of_group(group)
    unknown = sorted(values.keys() - {option.name for option in known})
    if unknown:
        raise OptionError("unknown-option", f"there is no option {', '.join(unknown)}")
    parsed = {}
    for option in known:
        value = values.get(option.name)
        parsed[option.name] = option.default if value is None else option.read(value)
    return parsed


def parse_method(values: Mapping[str, Any]) -> dict[str, Any]:
    """The triangulation options parsed, with the method's settings where none is given.

    Raises OptionError: ``unknown-option``, ``bad-option``.
    """
    given = {name: value for name, value in values.items() if value is not None}
    method = BY_NAME["method"].read(given.get("method", BY_NAME["method"].default))
    return parse({**METHODS[method], **given}, "method")


def core_arguments(values: Mapping[str, Any], dem: DEM) -> dict[str, Any]:
    """What ``tin._core.triangulate`` takes, for the triangulation options ``values`` on ``dem``.

    Raises OptionError: ``unknown-option``, ``bad-option``.
    """
    options = parse_method(values)
    tolerance, limit, scales = options["tolerance"], options["max_points"], options["scales"]
    if limit is None and tolerance is None:
        limit = DEFAULT_POINTS
    stop_at_noise = limit == NOISE_STOP
    if stop_at_noise:
        limit = None
    is_share = isinstance(limit, Share)
    if isinstance(limit, Share):
        limit = max(MIN_POINTS, round(dem.n_valid * limit.percent / 100))
    return {
        "max_points": limit,
        "is_share": is_share,
        "points_per_scale": options["points_per_scale"],
        "priority": options["metric"],
        "weight": options["weight"],
        "candidate": options["candidate"],
        "tolerance": tolerance,
        # The paper's tolerance is on its metric; auto and max promise a maximum.
        "bound": options["metric"] if options["method"] == "median" else 1.0,
        "stop_at_noise": stop_at_noise,
        "scales": None if scales is None else [scale.in_pixels_of(dem) for scale in scales],
        "despike": options["despike"],
        "fit": options["fit"],
        "flips": options["flips"],
        # Along the longer of a pixel's sides, so that it holds in every direction.
        "outline_tolerance": min(options["outline_tolerance"].in_pixels_of(dem)),
        "keep_isolated": options["keep_isolated"],
        "sieve": options["sieve"],
        "tile": options["tile"],
        "threads": None if options["threads"] == ALL_CPUS else options["threads"],
    }
