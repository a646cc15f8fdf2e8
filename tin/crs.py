"""Coordinate reference systems, as far as a TIN needs them: read from WKT without any library."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

from tin.errors import InputError

UTM = "utm"
"""In the place of a CRS: the WGS 84 / UTM zone of a DEM's centre."""
_LENGTHS = {"metre": 1.0, "foot": 0.3048, "US survey foot": 1200 / 3937}
_SPELLINGS = {
    "metre": {"m", "metre", "metres", "meter", "meters"},
    "foot": {"ft", "foot", "feet", "international foot", "foot international"},
    "US survey foot": {"us ft", "ftus", "us survey foot", "us survey feet", "survey foot", "foot us"},
}
_GEOGRAPHIC = {"GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS"}
_COMPOUND = {"COMPD_CS", "COMPOUNDCRS"}
_VERTICAL = {"VERT_CS", "VERTCRS", "VERTICALCRS"}
_UNITS = {"UNIT", "LENGTHUNIT", "ANGLEUNIT"}
_TOKEN = re.compile(
    r'(?P<open>\w+)\s*[\[(]|(?P<close>[\])])|"(?P<text>(?:[^"]|"")*)"|(?P<word>[^\s,"\[\]()]+)'
)


def unit_name(text: str) -> str:
    """Return the standard name of a length unit ("metre", "foot", "US survey foot"), or "" if unknown."""
    plain = re.sub(r"[\W_]+", " ", text).strip().lower()
    return next((name for name, spellings in _SPELLINGS.items() if plain in spellings), "")


def unit_of_length(metres: float) -> str:
    """Return the name of the unit that is so many metres long, or "" if it is none of the known ones."""
    # The two feet differ by 2e-6 of their length, so the tolerance must be well below that.
    return next((name for name, length in _LENGTHS.items() if abs(metres / length - 1) < 2e-7), "")


def length_of_unit(name: str) -> float | None:
    """Return the length in metres of "metre", "foot" or "US survey foot", None for anything else."""
    return _LENGTHS.get(name)


@dataclass(frozen=True)
class CRS:
    """A coordinate reference system: its WKT, and the few facts about it that matter here.

    It has a ``to_wkt`` method, so rasterio, pyproj and geopandas take it as it is.
    """

    wkt: str
    """The definition, WKT2:2019 or WKT1 as the source gave it; a compound CRS keeps its vertical part."""
    code: str | None = None
    """Authority and code, such as "EPSG:26710", where there is one."""
    is_geographic: bool = False
    """True where x and y are longitude and latitude."""
    unit_factor: float = 1.0
    """Metres per horizontal unit; 1.0 for a geographic CRS."""
    unit_name: str = "metre"
    """"metre", "foot", "US survey foot", "degree", or the name in the WKT."""
    name: str = ""
    """Such as "NAD27 / UTM zone 10N"."""
    vertical_unit: str = ""
    """Unit of the vertical axis of a compound or 3D CRS: "metre", "foot", "US survey foot", or ""."""

    @classmethod
    def from_wkt(cls, wkt: str) -> CRS:
        """Read WKT1 or WKT2; raises InputError ("bad-crs") for anything else."""
        try:
            whole = _unwrap(_parse(wkt))
            horizontal = _horizontal(whole)
            unit = _unit(horizontal)
            vertical = _vertical_unit(whole)
            code = whole.child({"ID", "AUTHORITY"})
            is_geographic = horizontal.keyword in _GEOGRAPHIC and not _is_cartesian(horizontal)
            factor = 1.0 if unit is None or is_geographic else float(unit.values[1])
            text = "" if unit is None else unit.values[0]
            return cls(
                wkt=wkt,
                code=None if code is None else ":".join(code.values[:2]),
                is_geographic=is_geographic,
                unit_factor=factor,
                unit_name=text.lower() if is_geographic else unit_of_length(factor) or text,
                name=whole.values[0],
                vertical_unit="" if vertical is None else unit_of_length(float(vertical.values[1])),
            )
        except (IndexError, ValueError) as error:
            raise InputError("bad-crs", f"not a CRS definition (WKT): {_shorten(wkt)}") from error

    @classmethod
    def from_rasterio(cls, crs: Any) -> CRS:
        """Take over a rasterio CRS (or a pyproj one, which has the same two methods)."""
        made = cls.from_wkt(crs.to_wkt(version="WKT2_2019"))
        if made.code is None:
            epsg = crs.to_epsg()  # also finds the code of an ESRI-flavoured definition
            made = made if epsg is None else replace(made, code=f"EPSG:{epsg}")
        return made

    @classmethod
    def from_osgeo(cls, srs: Any) -> CRS:
        """Take over an ``osgeo.osr.SpatialReference``."""
        made = cls.from_wkt(srs.ExportToWkt(["FORMAT=WKT2_2019"]))
        if made.code is None:
            matches = [match for match, confidence in srs.FindMatches() if confidence >= 70]
            if matches:
                made = replace(made, code=cls.from_wkt(matches[0].ExportToWkt()).code)
        return made

    @classmethod
    def parse(cls, crs: Any) -> CRS | None:
        """Make a CRS of None, a CRS, an object with ``to_wkt()``, WKT, or a string such as "EPSG:26710".

        Raises InputError ("bad-crs") for anything else; a code needs rasterio ("missing-library").
        """
        if crs is None or isinstance(crs, CRS):
            return crs
        if hasattr(crs, "to_epsg"):
            return cls.from_rasterio(crs)
        if hasattr(crs, "to_wkt"):
            return cls.from_wkt(crs.to_wkt())
        if not isinstance(crs, str):
            raise InputError("bad-crs", f"not a CRS: {_shorten(repr(crs))}; give a code such as 'EPSG:26710'")
        if _TOKEN.match(crs.lstrip()) and "[" in crs:
            return cls.from_wkt(crs)
        try:
            import rasterio
            import rasterio.crs
        except ImportError as error:
            raise InputError(
                "missing-library", f"{crs} needs rasterio to look it up: pip install rasterio, or give WKT"
            ) from error
        try:
            with rasterio.Env():  # in which GDAL prints nothing
                return cls.from_rasterio(rasterio.crs.CRS.from_user_input(crs))
        except rasterio.errors.CRSError as error:
            raise InputError("bad-crs", f"unknown CRS: {_shorten(crs)}") from error

    @property
    def horizontal(self) -> CRS:
        """The horizontal part of a compound CRS; any other CRS itself."""
        whole = _unwrap(_parse(self.wkt))
        part = _horizontal(whole)
        return self if part is whole else CRS.from_wkt(self.wkt[part.start : part.end])

    def to_wkt(self, *_args: Any, **_kwargs: Any) -> str:
        """Return the WKT; arguments are taken, and ignored, so that other libraries may ask for a version."""
        return self.wkt

    def __str__(self) -> str:
        return self.code or self.name


class _Node:
    """One bracketed element of WKT, with its place in the text."""

    def __init__(self, keyword: str, start: int) -> None:
        self.keyword = keyword.upper()
        self.start, self.end = start, -1
        self.values: list[str] = []
        self.children: list[_Node] = []

    def child(self, keywords: set[str]) -> _Node | None:
        return next((c for c in self.children if c.keyword in keywords), None)


def _parse(wkt: str) -> _Node:
    root = _Node("", 0)
    stack = [root]
    for token in _TOKEN.finditer(wkt):
        if token["open"] is not None:
            stack.append(_Node(token["open"], token.start()))
        elif token["close"] is not None:
            node = stack.pop()
            node.end = token.end()
            stack[-1].children.append(node)
        else:
            text = token["text"]
            stack[-1].values.append(token["word"] if text is None else text.replace('""', '"'))
    if len(stack) != 1:
        raise ValueError("unbalanced brackets")
    return root.children[0]


def _unwrap(node: _Node) -> _Node:
    source = node.child({"SOURCECRS"}) if node.keyword == "BOUNDCRS" else None
    return node if source is None else source.children[0]


def _horizontal(whole: _Node) -> _Node:
    return _unwrap(whole.children[0]) if whole.keyword in _COMPOUND else whole


def _unit(node: _Node) -> _Node | None:
    axis = node.child({"AXIS"})
    return node.child(_UNITS) or (None if axis is None else axis.child(_UNITS))


def _vertical_unit(whole: _Node) -> _Node | None:
    parts = [_unwrap(part) for part in whole.children]
    vertical = next((part for part in parts if part.keyword in _VERTICAL), None)
    if vertical is not None:
        return _unit(vertical)
    axes = [part for part in parts if part.keyword == "AXIS"]
    third = axes[2] if len(axes) == 3 and "up" in axes[2].values else None
    return None if third is None else third.child(_UNITS) or whole.child(_UNITS)


def _is_cartesian(node: _Node) -> bool:
    system = node.child({"CS"})
    return system is not None and system.values[0].lower() == "cartesian"


def _shorten(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
