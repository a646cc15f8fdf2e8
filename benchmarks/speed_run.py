"""One run of one program in a process of its own, for ``speed.py``: prints its figures as JSON.

python benchmarks/speed_run.py '{"heights": "z.npy", "program": "auto", "threads": 1, "points": 5000,
                                 "tolerance": null, "errors": true}'

``{"program": "hmm", "hmm": "path/to/it"}`` wants the picture of the heights beside them, z.png.
"""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hmm
import numpy as np
from common import evaluate, rasterise
from process import forget_peak, memory

import tin
from tin import _core, options
from tin.constraints import Constraints

Job = dict[str, Any]
Mesh = tuple[np.ndarray, np.ndarray]
"""(n, 3) column, row and height, and (m, 3) corners."""


def timed(run: Callable[[], Any], figures: dict[str, Any]) -> Any:
    """The result of ``run``, and its time and memory; the peak of what was before is not its own."""
    forget_peak()
    figures["before_mb"] = memory("VmRSS")
    start = time.perf_counter()
    result = run()
    figures["seconds"] = time.perf_counter() - start
    figures["peak_mb"] = memory("VmHWM")
    return result


def by_us(job: Job, figures: dict[str, Any]) -> Mesh:
    """A method of dem2tin; the figures have the seconds by stage, too."""
    # The DEM holds a copy, and the core reads that one.
    dem = tin.DEM(np.load(job["heights"]))
    given = {"method": job["program"], "max_points": job["points"], "tolerance": job["tolerance"]}
    if "threads" in options.BY_NAME:
        given["threads"] = job["threads"]
    elif job["threads"] != 1:
        raise SystemExit("this dem2tin has no option for threads: it runs on one")
    arguments = {**options.core_arguments(given, dem), **Constraints().core_arguments()}
    spent: dict[str, float] = defaultdict(float)
    last = ["start", time.perf_counter()]

    def watch(stage: str, fraction: float) -> bool:
        now = time.perf_counter()
        spent[last[0]] += now - last[1]
        last[:] = stage, now
        return True

    def run() -> _core.Mesh:
        last[1] = time.perf_counter()
        mesh = _core.triangulate(dem.z, dem.metric(), progress=watch, **arguments)
        watch("end", 1.0)
        return mesh

    mesh = timed(run, figures)
    figures["stages"] = spent
    return np.column_stack([mesh.pixels(), mesh.heights()]), mesh.triangles()


def by_pydelatin(job: Job, figures: dict[str, Any]) -> Mesh:
    from pydelatin import Delatin

    z, points, tolerance = np.load(job["heights"]), job["points"], job["tolerance"]
    # It wants a tolerance even where it is to stop by the number of points.
    stop = {"max_error": 1e-9, "max_points": points} if tolerance is None else {"max_error": tolerance}
    mesh = timed(lambda: Delatin(z, **stop), figures)
    # The error of the point that it would insert next.
    vertices, triangles, figures["next_error"] = mesh.vertices.copy(), mesh.triangles, mesh.error
    # Its y points upwards.
    vertices[:, 1] = z.shape[0] - 1 - vertices[:, 1]
    return vertices, triangles


def by_hmm(job: Job, figures: dict[str, Any]) -> Mesh:
    heights = Path(job["heights"])
    z = np.load(heights, mmap_mode="r")
    found, vertices, triangles = hmm.triangulate(
        job["hmm"], z, heights.with_suffix(".png"), job["points"], job["tolerance"]
    )
    figures |= found
    return vertices, triangles


PEERS = {"pydelatin": by_pydelatin, "hmm": by_hmm}


def main() -> None:
    job = json.loads(sys.argv[1])
    figures: dict[str, Any] = {}
    vertices, triangles = PEERS.get(job["program"], by_us)(job, figures)
    figures.setdefault("vertices", len(vertices))
    if job["errors"]:
        truth = np.load(job["heights"], mmap_mode="r")
        errors = evaluate(rasterise(vertices, triangles, truth.shape), truth)
        figures |= {"largest": errors.largest, "rmse": errors.rmse, "missing": errors.missing}
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
