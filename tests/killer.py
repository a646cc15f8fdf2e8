"""Forks one writer after another and kills each with SIGKILL at a random moment; run by test_kill.py.

Arguments: the target, the number of kills, 1 if an old file is in place. Prints the outcomes as JSON.
"""

from __future__ import annotations

import json
import os
import random
import signal
import statistics
import sys
import time
from collections import Counter
from pathlib import Path

from fakes import crs, grid_tin

from tin import formats

SIDES = {".gpkg": 40, ".obj": 100, ".tif": 300}
OLD = b"what was there before\n"


def start(tin: object, target: Path, *, overwrite: bool) -> int:
    child = os.fork()
    if child == 0:
        try:
            formats.write(tin, target, overwrite=overwrite)
        finally:
            os._exit(int(sys.exc_info()[0] is not None))
    return child


def finish(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def whole_files(tin: object, target: Path) -> tuple[dict[str, bytes], float]:
    """The bytes of each file that a write makes, and the seconds it takes. All in children: this
    process must have no threads of GDAL that a fork would lose.
    """
    apart = target.parent / "whole"
    apart.mkdir()
    times = []
    for _ in range(7):
        before = time.perf_counter()
        assert finish(start(tin, apart / target.name, overwrite=True)) == 0
        times.append(time.perf_counter() - before)
    return {path.name: path.read_bytes() for path in apart.iterdir()}, statistics.median(times)


def main() -> None:
    target, kills, has_old = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "1"
    formats.accepted(target, {})  # imports the writer's library, once for all children
    side = SIDES[target.suffix]
    tin = grid_tin(side, side, crs=crs("EPSG:26710"))
    whole, seconds = whole_files(tin, target)
    moments = random.Random(1)
    outcomes: Counter[str] = Counter()
    stale = 0
    for _ in range(kills):
        for name in whole:
            path = target.with_name(name)
            if has_old:
                path.write_bytes(OLD)
            else:
                path.unlink(missing_ok=True)
        child = start(tin, target, overwrite=has_old)
        time.sleep(moments.uniform(0, 1.1 * seconds))
        os.kill(child, signal.SIGKILL)
        code = finish(child)
        for name, content in whole.items():
            try:
                found = target.with_name(name).read_bytes()
            except FileNotFoundError:
                found = None
            state = {None: "absent", OLD: "old", content: "whole"}.get(found, "broken")
            outcomes[state if name == target.name else f"companion {state}"] += 1
        left = len(list(target.parent.glob(".*.part")))
        outcomes["in the middle"] += left > stale
        outcomes["finished before"] += code == 0
        outcomes["failed"] += code not in (0, -signal.SIGKILL)
        stale = left
    for name in whole:
        target.with_name(name).unlink(missing_ok=True)
    again = finish(start(tin, target, overwrite=False))
    outcomes["written after all"] += again == 0 and all(
        target.with_name(name).read_bytes() == content for name, content in whole.items()
    )
    print(json.dumps(outcomes))


if __name__ == "__main__":
    main()
