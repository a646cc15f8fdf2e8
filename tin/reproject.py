"""A TIN in another CRS: its vertices moved, its long edges split so that they follow the ground."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tin import transform
from tin.dem import DEM
from tin.errors import InputError

if TYPE_CHECKING:
    from tin.crs import CRS
    from tin.tin import Tin

Places = npt.NDArray[np.float64]

MAX_BEND = 1.0  # pixels that an edge's middle may be off the straight line between its moved ends
SHORT = 16.0  # pixels: shorter edges stay as good as straight, unless a triangle turns over
TORN = 0.49  # of its length: where the middle of an edge is as far off, the map is cut between its ends
ROUNDS = 64  # an edge halved as often has no length left
_NEAR = 0.01  # of a triangle's sides: near enough to its corner to see whether the map is mirrored there
_ROUNDING = 1e-6  # pixels: a middle that is less off is not off at all


def to_crs(tin: Tin, crs: Any) -> Tin:
    """Return ``tin`` with its vertices in another CRS, see ``Tin.to_crs``.

    A straight line is not straight in another CRS. Where the middle of an edge would be more than
    MAX_BEND pixels off, or a sliver beside an edge would turn over, the edge is split there.
    """
    goal = transform.target(tin.dem, crs)
    assert tin.crs is not None
    if transform.is_same(tin.crs, goal):
        return tin
    mesh = _Mesh(tin, goal)
    for _ in range(ROUNDS):
        if not mesh.split():
            break
    turned = int(mesh.turned().sum())
    if turned:
        raise _torn(goal, f"{turned:,} of {len(mesh.triangles):,} triangles would turn over")
    moved = copy.copy(tin)
    moved._set(goal, **mesh.parts())
    is_whole = len(moved.vertices) == len(tin.vertices)
    moved.report = replace(
        tin.report,
        points=len(moved.vertices),
        triangles=len(moved.triangles),
        delaunay=tin.report.delaunay and is_whole,
        crs=str(goal),
    )
    return moved


def on_own_grid(tin: Tin) -> Tin:
    """Return ``tin`` with its DEM, and its vertices' ``pixels``, on a grid in its own CRS, for drawing.

    Raises InputError "outside-crs".
    """
    if tin.crs is tin.dem.crs:
        return tin
    z, place = transform.to_grid(tin, tin.dem.z)
    view = copy.copy(tin)
    view.dem = DEM(z, transform=place, crs=tin.crs, vertical_unit=tin.dem.vertical_unit, name=tin.name)
    view.pixels = np.column_stack(view.dem.map_to_pixel(tin.vertices[:, 0], tin.vertices[:, 1]))
    return view


def _torn(goal: CRS, what: str) -> InputError:
    where = "as across the antimeridian, near a pole or far from the area that a CRS is made for"
    return InputError("turned-over", f"{what} in {goal}, {where}; choose another CRS, such as utm")


class _Mesh:
    """The triangles on their way, where they come from and in ``goal``."""

    def __init__(self, tin: Tin, goal: CRS) -> None:
        assert tin.crs is not None
        self.source, self.goal = tin.crs, goal
        self.before = np.column_stack([tin.vertices, tin.pixels])  # x, y, z, column, row
        self.after = self._moved(self.before)  # x, y
        self.triangles, self.constrained, self.errors = tin.triangles, tin.constrained, tin.triangle_errors
        widest = self.before[self.triangles[_doubled(self.before, self.triangles).argmax()], :2]
        near = self._moved(widest[0] + _NEAR * (widest - widest[0]))
        self.is_mirrored = bool(_doubled(near, np.array([[0, 1, 2]]))[0] < 0.0)

    def _moved(self, places: Places) -> Places:
        return transform.points(self.source, self.goal, places[:, :2])

    def parts(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of a Tin, with the triangles counter-clockwise in ``goal``."""
        turn = slice(None, None, -1 if self.is_mirrored else None)
        return {
            "vertices": np.column_stack([self.after, self.before[:, 2]]),
            "pixels": self.before[:, 3:].copy(),
            "triangles": np.ascontiguousarray(self.triangles[:, turn]),
            "constrained": self.constrained[:, [1, 0, 2]] if self.is_mirrored else self.constrained,
            "triangle_errors": self.errors,
        }

    def turned(self) -> npt.NDArray[np.bool_]:
        """(m,) whether a triangle has turned over, or has no area left."""
        doubled = _doubled(self.after, self.triangles)
        return (-doubled if self.is_mirrored else doubled) <= 0.0

    def split(self) -> bool:
        """Split edges that bend too much, at most one of a triangle; False if there are none."""
        n, turned = len(self.before), self.turned()
        start = self.triangles.astype(np.int64)
        ends = np.sort(np.stack([start, np.roll(start, -1, axis=1)]), axis=0)
        steps = self.before[ends[1], 3:] - self.before[ends[0], 3:]
        suspect = (np.hypot(steps[..., 0], steps[..., 1]) > SHORT) | turned[:, None]
        if not suspect.any():
            return False
        keys, number = np.unique((ends[0] * n + ends[1]).ravel(), return_inverse=True)
        number = number.reshape(-1, 3)  # (m, 3) of the edge from corner k to corner k + 1
        asked = np.unique(number[suspect])
        a, b = np.divmod(keys[asked], n)
        middles = (self.before[a] + self.before[b]) / 2.0
        moved = self._moved(middles)
        bend = _length(moved - (self.after[a] + self.after[b]) / 2.0) / _length(self.after[b] - self.after[a])
        if (bend > TORN).any():
            raise _torn(self.goal, f"{int((bend > TORN).sum()):,} edges would be torn apart")
        off = np.zeros(len(keys))
        off[asked] = bend * _length(self.before[b, 3:] - self.before[a, 3:])
        wanted = off > MAX_BEND
        worst = off[number[turned]].argmax(axis=1)
        wanted[number[turned, worst]] = True
        wanted &= off > _ROUNDING
        if not wanted.any():
            return False
        # Each triangle chooses the worst of its edges; split is what all triangles at an edge choose.
        place = np.empty(len(keys), np.int64)
        place[np.argsort(off, kind="stable")] = np.arange(len(keys))
        place[~wanted] = -1
        side = place[number].argmax(axis=1)
        chosen = number[np.arange(len(number)), side]
        votes, sides = (np.bincount(which.ravel(), minlength=len(keys)) for which in (chosen, number))
        agreed = np.flatnonzero(wanted & (votes == sides))
        middle = np.full(len(keys), -1)
        middle[agreed] = n + np.arange(len(agreed))
        new = np.searchsorted(asked, agreed)
        self.before = np.concatenate([self.before, middles[new]])
        self.after = np.concatenate([self.after, moved[new]])
        self._halve(np.flatnonzero(middle[chosen] >= 0), side, middle[chosen])
        return True

    def _halve(
        self, rows: npt.NDArray[Any], side: npt.NDArray[np.int64], middle: npt.NDArray[np.int64]
    ) -> None:
        """Cut the triangles ``rows`` from the vertex ``middle`` on their edge ``side`` to the far corner."""
        turn = (side[rows, None] + np.arange(3)) % 3
        a, b, c = self.triangles[rows[:, None], turn].T
        ab, bc, ca = self.constrained[rows[:, None], turn].T
        m = middle[rows].astype(self.triangles.dtype)
        no = np.zeros_like(ab)
        triangles, constrained = self.triangles.copy(), self.constrained.copy()
        triangles[rows], constrained[rows] = np.column_stack([a, m, c]), np.column_stack([ab, no, ca])
        self.triangles = np.concatenate([triangles, np.column_stack([m, b, c])])
        self.constrained = np.concatenate([constrained, np.column_stack([ab, bc, no])])
        self.errors = np.concatenate([self.errors, self.errors[rows]])


def _length(steps: Places) -> Places:
    """Return (n,) the lengths of (n, 2) steps; never 0."""
    return np.asarray(np.maximum(np.hypot(steps[:, 0], steps[:, 1]), np.finfo(float).tiny))


def _doubled(places: Places, triangles: npt.NDArray[Any]) -> Places:
    """Return (m,) twice the signed area of each triangle."""
    a, b, c = (places[triangles[:, k], :2] for k in range(3))
    u, v = b - a, c - a
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
