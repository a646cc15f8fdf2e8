"""The memory of this process, and work in a process of its own."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import time
from collections.abc import Callable
from pathlib import Path

STATUS = Path("/proc/self/status")


def memory(field: str) -> float:
    """Resident MB now ("VmRSS") or at most so far ("VmHWM"); NaN where the system does not say (not Linux).

    ``ru_maxrss`` would be wrong: a child inherits that of its parent.
    """
    if not STATUS.exists():
        return math.nan
    found = next(line for line in STATUS.read_text().splitlines() if line.startswith(field))
    return int(found.split()[1]) / 1024


def forget_peak() -> None:
    """Let the peak start anew."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def forked(prepare: Callable[[], Callable[[], object]]) -> tuple[float, float]:
    """Seconds of what ``prepare`` returns, and the MB that it adds to the memory at its peak.

    Both run in a process of their own that sees all objects of this one.
    """
    context = multiprocessing.get_context("fork")
    figures = context.SimpleQueue()

    def work() -> None:
        run = prepare()
        forget_peak()
        before, start = memory("VmRSS"), time.perf_counter()
        run()
        figures.put((time.perf_counter() - start, memory("VmHWM") - before))

    child = context.Process(target=work)
    child.start()
    child.join()
    if child.exitcode:
        raise SystemExit(f"a process failed ({child.exitcode})")
    return figures.get()
