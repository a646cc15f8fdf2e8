"""Kill -9 at random moments: whatever a name stands for is whole."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
KILLS = 100  # with an old file in place, and as many without


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and kill")
@pytest.mark.parametrize("has_old", [True, False], ids=["over an old file", "a new file"])
@pytest.mark.parametrize("suffix", [".gpkg", ".obj", ".tif"])
def test_whenever_it_is_killed_a_file_is_old_or_whole_or_absent(tmp_path, suffix, has_old):
    environment = {
        **os.environ,
        "PYTHONPATH": f"{TESTS}{os.pathsep}{TESTS.parent}",
        "OGR_CURRENT_DATE": "2024-01-01T00:00:00.000Z",  # the one thing in a GeoPackage that varies
    }
    command = [sys.executable, TESTS / "killer.py", tmp_path / f"a{suffix}", str(KILLS), str(int(has_old))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    outcomes = json.loads(done.stdout)
    for left in tmp_path.glob(".*.part"):  # a hundred megabytes that pytest would keep
        shutil.rmtree(left)
    assert outcomes.get("broken", 0) == outcomes.get("companion broken", 0) == outcomes["failed"] == 0
    assert outcomes.get("whole", 0) + outcomes.get("old" if has_old else "absent", 0) == KILLS
    assert outcomes["in the middle"] >= KILLS // 10
    assert outcomes["written after all"] == 1
