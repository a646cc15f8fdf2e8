"""The scripts of the benchmarks run, on inputs too small for their numbers to mean anything."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tin
import tin.options

for library in ("matplotlib", "scipy", "pydelatin", "pyfqmr", "OpenImageIO"):
    importlib.import_module(library)

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))


def script(name):
    return importlib.import_module(name)


def hills(rows, cols):
    row, col = np.mgrid[0:rows, 0:cols]
    return 100 + 80 * np.sin(col / 9) * np.cos(row / 7)


def image(path, values):
    import OpenImageIO as oiio

    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), oiio.ImageSpec(values.shape[1], values.shape[0], 1, "uint8"))
    out.write_image(np.rint(values).astype(np.uint8)[..., None])
    out.close()


def test_the_evaluator_agrees_with_the_core_and_knows_what_is_missing():
    common = script("common")
    z = hills(31, 43)
    z[10:15, 20:30] = np.nan
    mesh = tin.triangulate(tin.DEM(z), max_points=90)
    heights = np.column_stack([mesh.pixels, mesh.vertices[:, 2]])
    surface = common.rasterise(heights, mesh.triangles, z.shape)
    np.testing.assert_allclose(surface, mesh.rasterize(), rtol=1e-9)
    errors = common.evaluate(surface, z)
    assert errors.rmse == pytest.approx(mesh.error().rmse)
    assert errors.mae == pytest.approx(mesh.error().mae)
    assert errors.largest == pytest.approx(mesh.error().max_error)
    half = common.rasterise(heights, mesh.triangles[::2], z.shape)
    assert common.evaluate(half, z).missing == (np.isfinite(z) & np.isnan(half)).sum() > 0


def test_the_evaluator_takes_vertices_anywhere():
    common = script("common")
    points = np.array([[-0.5, -0.25, 0.0], [7.5, 0.0, 8.0], [0.0, 9.5, 9.5], [3.0, 3.0, 1.0]])
    surface = common.rasterise(points, np.array([[0, 1, 2], [0, 3, 3]]), (6, 6))
    row, col = np.mgrid[0:6, 0:6]
    inside = np.isfinite(surface)
    plane = np.linalg.solve(np.column_stack([points[:3, :2], np.ones(3)]), points[:3, 2])
    assert 15 < inside.sum() < 36
    np.testing.assert_allclose(surface[inside], (plane[0] * col + plane[1] * row + plane[2])[inside])


@pytest.mark.parametrize("method", ["by_pydelatin", "by_pyfqmr", "by_grid"])
def test_the_other_methods_give_the_surface_they_claim(method):
    accuracy, common = script("accuracy"), script("common")
    z = hills(40, 56)
    vertices, triangles = getattr(accuracy, method)(z, 200)
    errors = common.evaluate(common.rasterise(vertices, triangles, z.shape), z)
    assert len(np.unique(triangles)) == pytest.approx(200, rel=0.1)
    assert errors.rmse < 8
    assert errors.missing < (100 if method == "by_pyfqmr" else 1)  # it shrinks a free border


def test_accuracy(monkeypatch, capsys, tmp_path):
    accuracy, common = script("accuracy"), script("common")
    monkeypatch.setattr(common, "SAMPLE", tmp_path)
    image(tmp_path / "made.png", hills(40, 50))
    monkeypatch.setattr(accuracy, "SAMPLE", tmp_path / "made.png")
    accuracy.main(["--size", "24", "--percent", "8"])
    shown = capsys.readouterr().out
    assert shown.count("| **auto** |") == 3 * 3 + 1
    assert "### made (50 × 40), as it is, 8 %" in shown
    assert "| pyfqmr |" in shown


def test_speed(capsys):
    speed = script("speed")
    speed.main(["--size", "40", "--rounds", "2", "--terrain", "smooth", "--methods", "median", "auto"])
    shown = capsys.readouterr().out
    assert shown.count("\n### smooth 40 × 40, ") == 2
    assert shown.count("\n| median | 80 |") == 1
    assert shown.count("\n| auto |") == shown.count("\n| pydelatin |") == 2
    assert "\n| refine | 1.00 |" in shown
    sizes = ["--size", "24", "32", "--rounds", "1"]
    speed.main([*sizes, "--terrain", "sample", "--methods", "max", "--no-errors"])
    shown = capsys.readouterr().out
    assert shown.count("\n### sample 24 × 24, ") == shown.count("\n### sample 32 × 32, ") == 2
    assert shown.count("| — | — |") == 2 * 2 * 2
    assert "auto" not in shown


def test_one_run_has_the_errors_of_the_mesh_it_made(tmp_path):
    speed = script("speed")
    np.save(tmp_path / "z.npy", hills(50, 70).astype(np.float32))
    job = {"heights": str(tmp_path / "z.npy"), "threads": 1, "errors": True}
    for program in ("max", "pydelatin"):
        by_points = speed.run({**job, "program": program, "points": 120, "tolerance": None})
        assert by_points["vertices"] == 120
        assert 0 < by_points["rmse"] < by_points["largest"] < 20
        assert by_points["missing"] == 0
        assert 0 < by_points["before_mb"] <= by_points["peak_mb"] < 500
        by_tolerance = speed.run({**job, "program": program, "points": None, "tolerance": 5.0})
        assert by_tolerance["vertices"] > 4
        assert 2.5 < by_tolerance["largest"] <= 5.0 + 1e-4
    with pytest.raises(SystemExit, match="none of"):
        speed.run({**job, "program": "least", "points": 120, "tolerance": None})


# Reads, prints and writes as hmm does; what triangulates is pydelatin, which is a port of it.
FAKE_HMM = f"""#!{sys.executable}
import sys
import numpy as np
from PIL import Image
from pydelatin import Delatin

options = dict(zip(sys.argv[1:-2:2], sys.argv[2:-2:2]))
grey = np.asarray(Image.open(sys.argv[-2])).astype(np.float32) / np.float32(65535)
mesh = Delatin(grey, max_error=float(options["-e"]), max_points=int(options.get("-p", 0)) or None)
print("loading heightmap... 0.5s")
print("triangulating... 1.5e-03s")
print(f"  error = {{mesh.error:g}}")
print(f"  points = {{len(mesh.vertices)}}")
stl = np.zeros(len(mesh.triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("count", "<u2")])
stl["corners"] = (mesh.vertices * [1, 1, float(options["-z"])])[mesh.triangles]
with open(sys.argv[-1], "wb") as file:
    file.write(bytes(80) + np.uint32(len(stl)).tobytes() + stl.tobytes())
"""


@pytest.fixture
def fake_hmm(tmp_path):
    path = tmp_path / "hmm"
    path.write_text(FAKE_HMM)
    path.chmod(0o755)
    return str(path)


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a script")
def test_hmm_gets_the_heights_and_its_mesh_is_put_back_into_their_units(tmp_path, fake_hmm):
    speed, hmm = script("speed"), script("hmm")
    z = (hills(50, 70) - 250).astype(np.float32)
    np.save(tmp_path / "z.npy", z)
    hmm.write_png(z, tmp_path / "z.png")
    job = {"heights": str(tmp_path / "z.npy"), "threads": 1, "hmm": fake_hmm, "errors": True}
    for stop in ({"points": 120, "tolerance": None}, {"points": None, "tolerance": 5.0}):
        found = speed.run({**job, "program": "hmm", **stop})
        other = speed.run({**job, "program": "pydelatin", **stop})
        assert found["seconds"] == 1.5e-3
        assert found["missing"] == 0
        # Hills are alike, so that the rounding to grey levels changes the order of insertion.
        assert found["vertices"] == pytest.approx(other["vertices"], rel=0.1)
        for key in ("next_error", "largest", "rmse"):
            assert found[key] == pytest.approx(other[key], rel=0.15)
    Path(fake_hmm).write_text(f"#!{sys.executable}\nprint('invalid heightmap file')\n")
    with pytest.raises(SystemExit, match="invalid heightmap file"):
        speed.run({**job, "program": "hmm", "points": 120, "tolerance": None})


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a script")
def test_the_faster_peer_of_each_round_is_the_base(capsys, fake_hmm):
    speed = script("speed")
    own, peers = speed.Program("max", 2), (speed.Program("pydelatin"), speed.Program("hmm"))
    runs = {
        program: [{"seconds": second, "vertices": 9} for second in seconds]
        for program, seconds in (
            (own, (1.0, 2.0, 3.0)),
            (peers[0], (2.0, 9.0, 9.0)),
            (peers[1], (5.0, 5.0, 9.0)),
        )
    }
    row = dict(zip(speed.HEADER, speed.row(own, runs, 10**9)))
    assert row["program"] == "max, 2 threads"
    assert (row["speed-up"], row["of the base's time"], row["of `max`'s time"]) == ("2.50", "0.40", "1.00")
    assert (row["min s"], row["median s"], row["ns a pixel"]) == ("1.000", "2.000", "2")
    row = dict(zip(speed.HEADER, speed.row(peers[0], runs, 10**9)))
    assert (row["speed-up"], row["of `max`'s time"], row["MB more at peak"]) == ("1.00", "—", "—")
    sizes = ["--size", "32", "--rounds", "1", "--percent", "3", "6", "--terrain", "smooth"]
    speed.main([*sizes, "--methods", "max", "--hmm", fake_hmm])
    shown = capsys.readouterr().out
    assert shown.count("\n| hmm | ") == shown.count("\n| pydelatin | ") == shown.count("\n| max | ") == 4
    assert "31 points (3 %)" in shown
    assert "61 points (6 %)" in shown


def test_threads_are_given_to_the_core_or_refused(capsys):
    speed = script("speed")
    arguments = ["--size", "32", "--rounds", "1", "--terrain", "smooth", "--methods", "max", "--threads", "2"]
    if "threads" not in tin.options.BY_NAME:
        with pytest.raises(SystemExit, match="no option for threads"):
            speed.main(arguments)
        return
    speed.main(arguments)
    assert capsys.readouterr().out.count("\n| max, 2 threads | ") == 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the writers run in forked processes")
def test_writers():
    command = [sys.executable, FOLDER / "writers.py", "--size", "60", "--percent", "4", "8", "--rounds", "1"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert shown.count("| pyogrio's `raw.write` |") == shown.count("| UGRID |") == 2
    assert "`dem2tin --help`: " in shown
    assert shown.count("| GeoTIFF, 8 % | ") == 1


@pytest.mark.parametrize(("name", "slope"), [("smooth", 3.0), ("rough", 2.2)])
def test_made_terrain_is_as_rough_as_it_says(name, slope):
    made_terrain = script("made_terrain")
    z = made_terrain.make(name, 256)
    assert (z.dtype, z.min(), z.max()) == (np.float32, 0.0, 1000.0)
    np.testing.assert_array_equal(z, made_terrain.make(name, 256))
    power = np.mean(np.abs(np.fft.rfft(z.astype(np.float64) * np.hanning(256), axis=1)) ** 2, axis=0)
    frequency = slice(6, 100)
    logs = np.log(np.arange(129)[frequency]), np.log(power[frequency])
    assert np.polyfit(*logs, 1)[0] == pytest.approx(-slope, abs=0.15)


def test_instructions_over_the_budget_fail_and_those_under_it_are_told():
    instructions = script("instructions")
    budget = {"max": 1000, "median": 1000, "auto": 1000}
    lines, within = instructions.judge({"max": 1029, "median": 971, "auto": 960}, budget)
    assert within
    assert [line.endswith("--record") for line in lines] == [False, False, True]
    lines, within = instructions.judge({"max": 1031, "median": 1000, "auto": 1000}, budget)
    assert not within
    assert "OVER" in lines[0]
    recorded = json.loads(instructions.BUDGET.read_text(encoding="utf-8"))
    assert set(recorded["instructions"]) == set(instructions.METHODS)


def test_stages(monkeypatch, capsys, tmp_path):
    stages = script("stages")
    image(tmp_path / "made.png", hills(40, 50))
    monkeypatch.setattr(stages, "SAMPLE", tmp_path / "made.png")
    stages.main(["--size", "24"])
    shown = capsys.readouterr().out
    assert "| `auto` | 1.00 | 1.00 | 1.00 | 1.00 |" in shown
    assert shown.count("\n| ") == len(stages.VARIANTS) + 2


def test_paper_tables_and_figures(capsys, tmp_path):
    for name in ("peppers", "baboon"):
        image(tmp_path / f"{name}_gray.png", hills(40, 40))
    paper = script("paper_tables")
    arguments = ["--images", str(tmp_path), "--runs", "3", "--share", "0.008"]
    paper.main([*arguments, "--figures", str(tmp_path / "figures")])
    shown = capsys.readouterr().out
    for title in ("## Table 1", "## Table 2", "## Method auto", "## Requirements"):
        assert title in shown
    assert "| max | 1,000 | 23.27 |" in shown
    assert shown.count("within 3 %") == shown.count("within 8 %") == 3
    assert shown.count("within 10 %") == 4
    assert shown.count("beat") == 4
    for name in ("figure1.png", "figure3.png"):
        assert (tmp_path / "figures" / name).stat().st_size > 1000


def test_paper_tables_want_three_seeds_and_the_images(tmp_path):
    paper = script("paper_tables")
    with pytest.raises(SystemExit):
        paper.main(["--images", str(tmp_path), "--runs", "2"])
    with pytest.raises(SystemExit, match="no image"):
        paper.main(["--images", str(tmp_path)])
