"""Whether x, y and z of a TIN are in one unit, as every 3D program takes them to be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tin.crs import length_of_unit

if TYPE_CHECKING:
    from tin.crs import CRS

_SAME = 1e-5  # the two feet differ by 2e-6 of their length, which nobody sees


def warning(crs: CRS | None, vertical_unit: str, z_factor: float = 1.0) -> str | None:
    """Return what to warn of before a mesh is shown in 3D, and what to do about it; None if all is well.

    ``vertical_unit`` is "metre", "foot", "US survey foot", or "" where it is unknown; ``z_factor`` is the
    one that the heights have been multiplied by. Without a CRS nothing is known, and nothing said.
    """
    if crs is None:
        return None
    height = length_of_unit(vertical_unit)
    heights = f"heights in {vertical_unit}" if vertical_unit else "heights in an unknown unit"
    to_metres = "" if height in (None, 1.0) else f", --z-factor {z_factor * height:.10g} the heights"
    if crs.is_geographic:
        return (
            f"x and y are in degrees, {heights}: in 3D the terrain looks a hundred thousand times too high; "
            f"--to-crs utm puts x and y in metres{to_metres}"
        )
    both = f"x and y are in {crs.unit_name}, {heights}"
    if height is not None and abs(height / crs.unit_factor - 1.0) > _SAME:
        advice = f"--z-factor {z_factor * height / crs.unit_factor:.10g} puts the heights in {crs.unit_name}"
        if crs.unit_factor != 1.0:
            advice += f", --to-crs utm puts x and y in metres{to_metres}"
        return f"{both}: in 3D the terrain has the wrong steepness; {advice}"
    if abs(crs.unit_factor - 1.0) > _SAME:
        return f"{both}: 3D programs take them for metres; --to-crs utm puts x and y in metres{to_metres}"
    return None
