"""One run of one program in a process of its own, for ``speed.py``: prints its figures as JSON.

python benchmarks/speed_run.py '{"heights": "z.npy", "program": "auto", "points": 5000,
                                 "tolerance": null, "errors": true}'
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from common import evaluate, rasterise

import tin
from tin import _core, options
from tin.constraints import Constraints

STATUS = Path("/proc/self/status")


def memory(field: str) -> float:
    """Resident MB now ("VmRSS") or at most so far ("VmHWM"); NaN where the system does not say (not Linux).

    ``ru_maxrss`` would be wrong: a child inherits that of its parent.
    """
    if not STATUS.exists():
        return math.nan
    found = next(line for line in STATUS.read_text().splitlines() if line.startswith(field))
    return int(found.split()[1]) / 1024


def ours(z: np.ndarray, method: str, **stop: float | None) -> tuple[Callable, dict]:
    """What makes the mesh; and the seconds by stage, filled in when it is called."""
    dem = tin.DEM(z)
    arguments = options.core_arguments({"method": method, **stop}, dem)
    spent: dict[str, float] = defaultdict(float)
    last = ["start", time.perf_counter()]

    def watch(stage: str, fraction: float) -> bool:
        now = time.perf_counter()
        spent[last[0]] += now - last[1]
        last[:] = stage, now
        return True

    def run() -> _core.Mesh:
        last[1] = time.perf_counter()
        mesh = _core.triangulate(
            dem.z, dem.metric(), progress=watch, **arguments, **Constraints().core_arguments()
        )
        watch("end", 1.0)
        return mesh

    return run, spent


def main() -> None:
    given = json.loads(sys.argv[1])
    z = np.load(given["heights"])
    points, tolerance = given["points"], given["tolerance"]
    figures: dict[str, object] = {}
    if given["program"] == "pydelatin":
        from pydelatin import Delatin

        # It wants a tolerance even where it is to stop by the number of points.
        stop = {"max_error": 1e-9, "max_points": points} if tolerance is None else {"max_error": tolerance}

        def run() -> Delatin:
            return Delatin(z, **stop)
    else:
        run, figures["stages"] = ours(z, given["program"], max_points=points, tolerance=tolerance)
        # The DEM holds a copy, and the core reads that one.
        z = None
    with contextlib.suppress(OSError):
        # The peak so far is forgotten: that of the loading is not the program's.
        Path("/proc/self/clear_refs").write_text("5")
    before = memory("VmRSS")
    start = time.perf_counter()
    mesh = run()
    figures["seconds"] = time.perf_counter() - start
    figures["before_mb"], figures["peak_mb"] = before, memory("VmHWM")
    if given["program"] == "pydelatin":
        # The error of the point that it would insert next.
        vertices, triangles, figures["next_error"] = mesh.vertices.copy(), mesh.triangles, mesh.error
        # Its y points upwards.
        vertices[:, 1] = z.shape[0] - 1 - vertices[:, 1]
    else:
        vertices, triangles = np.column_stack([mesh.pixels(), mesh.heights()]), mesh.triangles()
    figures["vertices"] = len(vertices)
    if given["errors"]:
        truth = np.load(given["heights"], mmap_mode="r")
        del mesh
        errors = evaluate(rasterise(vertices, triangles, truth.shape), truth)
        figures |= {"largest": errors.largest, "rmse": errors.rmse, "missing": errors.missing}
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
