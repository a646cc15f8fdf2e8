"""Counts the instructions of a small fixed case and compares them with the recorded budget.

    make instructions [INSTRUCTIONS=--record]
    python benchmarks/instructions.py [--record] BINARY

Callgrind counts core/examples/fixed_case.rs inside the call of the core. Unlike seconds, the counts
do not change on a busy machine, but for some ten parts in a million; another compiler or C library
moves them more. More than 3 % over the budget fails; more than 3 % under it is said, so that the budget is
lowered with --record. Needs valgrind and nothing else.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path

# The C library chooses among its functions by the processor; it is told to take the plainest, since
# these counts differ by up to 2 % else.
PLAIN = "glibc.cpu.hwcaps=-AVX,-AVX2,-FMA,-FMA4,-ERMS,-FSRM"
BUDGET = Path(__file__).with_suffix(".json")
METHODS = ("max", "median", "auto")
MARGIN = 0.03


def count(binary: Path, method: str) -> int:
    """Instructions of one run of ``method``."""
    options = ["--tool=callgrind", "--callgrind-out-file=/dev/null", "--toggle-collect=*counted_run*"]
    command = ["valgrind", *options, str(binary), method]
    environment = {**os.environ, "GLIBC_TUNABLES": PLAIN}
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    except FileNotFoundError:
        raise SystemExit("valgrind is not on this machine") from None
    found = re.search(r"Collected : (\d+)", done.stderr)
    if done.returncode or not found or int(found[1]) == 0:
        raise SystemExit(f"{' '.join(command)}: no count\n{done.stdout}{done.stderr}")
    return int(found[1])


def compiler() -> str:
    return subprocess.run(["rustc", "-V"], capture_output=True, text=True, check=True).stdout.strip()


def judge(counts: dict[str, int], budget: dict[str, int]) -> tuple[list[str], bool]:
    """A line for each method, and whether all are within the budget."""
    lines, within = [], True
    for method, counted in counts.items():
        change = counted / budget[method] - 1.0
        verdict = ""
        if change > MARGIN:
            verdict, within = "  OVER the budget", False
        elif change < -MARGIN:
            verdict = "  under the budget: lower it with --record"
        lines.append(f"{method:8}{counted:>15,}  budget {budget[method]:>15,}  {change:+7.2%}{verdict}")
    return lines, within


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("binary", type=Path, metavar="BINARY", help="core/examples/fixed_case.rs, built")
    parser.add_argument("--record", action="store_true", help="make the counts the new budget")
    given = parser.parse_args(arguments)
    counts = {method: count(given.binary, method) for method in METHODS}
    if given.record:
        recorded = {"compiler": compiler(), "instructions": counts}
        BUDGET.write_text(json.dumps(recorded, indent=2) + "\n", encoding="utf-8")
    recorded = json.loads(BUDGET.read_text(encoding="utf-8"))
    lines, within = judge(counts, recorded["instructions"])
    print("\n".join(lines))
    if not within:
        print(f"The budget was recorded with {recorded['compiler']}; this is {compiler()}.", file=sys.stderr)
        raise SystemExit(1)


if __name__ == "__main__":
    main()
