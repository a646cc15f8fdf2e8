"""How far a TIN is from its DEM, and what a run reports."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Errors:
    """Vertical errors of the TIN over the valid pixels it covers, in the DEM's vertical unit."""

    rmse: float
    mae: float
    p95: float
    """95 % of the pixels have at most this absolute error."""
    max_error: float
    mean: float
    """Signed: positive where the TIN lies above the DEM."""
    covered: int
    """Valid pixels that a triangle covers."""
    uncovered: int
    """Valid pixels that no triangle covers: isolated ones and lines one pixel wide."""
    void_covered: int
    """Void pixels that a triangle covers."""


@dataclass(frozen=True)
class Report:
    """What a run did and reached; ``to_dict`` gives the keys of ``--json``."""

    points: int
    triangles: int
    stop_reason: str
    """"points": the number asked for was reached; "tolerance": every triangle is within it;
    "noise": more points would only fit the noise; "exact": every pixel lies on the TIN; "outline": the
    outline of the data and the points given are already more than was asked for."""
    errors: Errors
    max_error_without_spikes: float
    """The largest error over the pixels that despiking left alone: what a tolerance promises."""
    spikes: int
    """Pixels that despiking replaced."""
    noise: float
    """Estimated standard deviation of the noise; 0 where no stage needed it."""
    scales: list[tuple[float, float]]
    """Standard deviations (x, y) in pixels of the smoothed images that were refined."""
    delaunay: bool
    """Whether every edge that is no constraint is Delaunay in the metric of the map."""
    seconds: float
    crs: str | None
    vertical_unit: str
    warnings: list[str] = field(default_factory=list)
    """What to know before the outputs are used, such as units that do not fit together."""

    def to_dict(self) -> dict[str, Any]:
        """Flat, with stable keys."""
        values = asdict(self)
        return {**values.pop("errors"), **values}

    def __str__(self) -> str:
        unit = f" {self.vertical_unit}" if self.vertical_unit else ""
        e = self.errors
        lines = [
            f"{self.points:,} points, {self.triangles:,} triangles in {self.seconds:.2f} s "
            f"(stopped by {self.stop_reason})",
            f"RMSE {e.rmse:.4g}, MAE {e.mae:.4g}, P95 {e.p95:.4g}, max {e.max_error:.4g}{unit}",
        ]
        if self.spikes:
            lines.append(
                f"{self.spikes:,} spikes replaced; "
                f"max error without them {self.max_error_without_spikes:.4g}{unit}"
            )
        if self.stop_reason == "outline":
            lines.append("the outline of the data and the points given need this many points")
        if e.uncovered:
            lines.append(
                f"{e.uncovered:,} valid pixels are not covered: clipped or sieved off, isolated, "
                "or on lines one pixel wide"
            )
        return "\n".join(lines)
