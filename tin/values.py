"""What the values of options may be: text or Python values in, what the core needs out, else ValueError."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tin.crs import CRS, UTM

if TYPE_CHECKING:
    from tin.dem import DEM

MIN_POINTS = 4
MAX_POINTS = 2**29  # the core numbers edges, six a vertex, in 32 bits
NOISE_STOP = "auto"
ALL_CPUS = "auto"
MAX_THREADS = 1024
MIN_TILE = 64  # pixels; smaller ones would be mostly seam
MAX_SIDE = 2**20  # pixels, of the core's lattice
MAX_SCALES = 32
MAX_SIGMA = 100.0  # pixels; the core refuses more


@dataclass(frozen=True)
class Distance:
    """A length on the ground, in units of the CRS (metres where it is geographic), or in pixels."""

    value: float
    in_pixels: bool = False

    def in_pixels_of(self, dem: DEM) -> tuple[float, float]:
        """The length along the columns' and along the rows' direction, in pixels."""
        if self.in_pixels:
            return self.value, self.value
        along_x, _, along_y = dem.metric()
        metres = self.value * (dem.crs.unit_factor if dem.crs else 1.0)
        return metres / math.sqrt(along_x), metres / math.sqrt(along_y)

    def __str__(self) -> str:
        return f"{self.value:g}{'px' if self.in_pixels else ''}"


@dataclass(frozen=True)
class Share:
    """A part of the DEM's valid pixels."""

    percent: float

    def __str__(self) -> str:
        return f"{self.percent:g}%"


def real(value: Any, least: float = 0.0, most: float = math.inf) -> float:
    """A finite number within the bounds."""
    if isinstance(value, bool):
        raise ValueError(f"{value!r} is not a number")
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{value!r} is not a number") from None
    if not math.isfinite(number) or not least <= number <= most:
        limits = [
            f"at {word} {limit:.10g}"
            for word, limit in (("least", least), ("most", most))
            if math.isfinite(limit)
        ]
        raise ValueError(", ".join([f"{value!r} must be a finite number", " and ".join(limits)]).rstrip(", "))
    return number


def whole(value: Any, least: int, most: float = math.inf) -> int:
    """A whole number within the bounds."""
    number = real(value, least, most)
    if number != int(number):
        raise ValueError(f"{value!r} is not a whole number")
    return int(number)


def points(value: Any) -> int | Share | str:
    """A number of points, a percentage, or "auto"."""
    if isinstance(value, Share):
        return value
    if isinstance(value, str) and value.strip().lower() == NOISE_STOP:
        return NOISE_STOP
    if isinstance(value, str) and value.strip().endswith("%"):
        percent = real(value.strip()[:-1], 0.0, 100.0)
        if percent == 0.0:
            raise ValueError("0% leaves no points; give more than that")
        return Share(percent)
    return whole(value, MIN_POINTS, MAX_POINTS)


def threads(value: Any) -> int | str:
    """A number of threads, or "auto"."""
    if isinstance(value, str) and value.strip().lower() == ALL_CPUS:
        return ALL_CPUS
    return whole(value, 1, MAX_THREADS)


def tile(value: Any) -> int:
    """The side of a tile in pixels, or 0."""
    side = whole(value, 0, MAX_SIDE)
    if 0 < side < MIN_TILE:
        raise ValueError(f"tiles are at least {MIN_TILE} pixels wide (0: no tiles)")
    return side


def distance(value: Any) -> Distance:
    """A number in ground units, or one with the suffix px."""
    if isinstance(value, Distance):
        return value
    text = value.strip() if isinstance(value, str) else value
    if isinstance(text, str) and text.lower().endswith("px"):
        return Distance(real(text[:-2], 0.0, MAX_SIGMA), in_pixels=True)
    return Distance(real(text))


def scales(value: Any) -> tuple[Distance, ...] | None:
    """Distances, as a list or with commas; None for "auto"."""
    if isinstance(value, str):
        if value.strip().lower() == "auto":
            return None
        parts: Iterable[Any] = value.split(",")
    else:
        parts = value if isinstance(value, Iterable) else [value]
    scales = tuple(distance(part) for part in parts)
    if not 1 <= len(scales) <= MAX_SCALES:
        raise ValueError(f"give 1 to {MAX_SCALES} scales")
    return scales


_QUANTILES = {"median": 0.5, "max": 1.0}


def quantile(value: Any) -> float:
    """ "median", "max", or a number above 0 up to 1."""
    number = _QUANTILES.get(value.strip().lower()) if isinstance(value, str) else None
    if number is None:
        number = real(value, 0.0, 1.0)
    if number == 0.0:
        raise ValueError("a quantile must be above 0 and at most 1")
    return number


def layer(value: Any) -> str:
    """The name of a vector file, perhaps with a layer."""
    return os.fsdecode(value)


def switch(value: Any) -> bool:
    """True or false."""
    if value in (True, False):
        return bool(value)
    raise ValueError(f"{value!r} is neither true nor false")


def factor(value: Any) -> float:
    """Any finite number but 0."""
    number = real(value, -math.inf)
    if number == 0.0:
        raise ValueError("a factor of 0 would make the DEM flat")
    return number


def crs(value: Any) -> Any:
    """ "utm", or what `CRS.parse` takes."""
    if isinstance(value, str) and value.strip().lower() == UTM:
        return UTM
    return CRS.parse(value)
