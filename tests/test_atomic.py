from __future__ import annotations

import contextlib
import os
import resource
import signal
import stat
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import pytest
from fakes import crs, grid_tin

from tin import formats
from tin.errors import OptionError, OutputError
from tin.formats import WRITERS, Writer, check_outputs, write
from tin.formats.atomic import Batch, atomic

SUFFIXES = (".gpkg", ".obj", ".tif")


def names(directory):
    return sorted(path.name for path in directory.iterdir())


def contents(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def code_of(call, *args, **options):
    with pytest.raises(OutputError) as caught:
        call(*args, **options)
    assert "\n" not in str(caught.value)
    assert ".part" not in str(caught.value)
    return caught.value.code


@contextlib.contextmanager
def file_size_limit(size):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextlib.contextmanager
def ordinary_user():
    """Root may write where permissions forbid it; be somebody else for a while."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_files_appear_together_and_alone(tmp_path):
    with atomic(tmp_path / "a.obj") as private:
        private.write_text("mesh")
        private.with_suffix(".prj").write_text("crs")
        assert private.parent.parent == tmp_path
        assert not (tmp_path / "a.obj").exists()
    assert contents(tmp_path) == {"a.obj": b"mesh", "a.prj": b"crs"}


@pytest.mark.parametrize("failure", [OSError("boom"), ValueError("boom"), KeyboardInterrupt(), MemoryError()])
def test_a_failure_leaves_what_was_there(tmp_path, failure):
    target = tmp_path / "a.obj"
    target.write_text("old")
    with pytest.raises((OutputError, type(failure))), atomic(target, overwrite=True) as private:
        private.write_text("half")
        raise failure
    assert contents(tmp_path) == {"a.obj": b"old"}


def test_a_writer_that_writes_nothing_is_a_failure(tmp_path):
    with pytest.raises(OutputError), atomic(tmp_path / "a.obj"):
        pass
    assert not names(tmp_path)


def three_files(directory, batch):
    for name in ("a.obj", "b.tif", "c.json"):
        with atomic(
            directory / name, overwrite=True, companions=[directory / "a.prj"], batch=batch
        ) as private:
            private.write_text("new")


@pytest.fixture
def old_files(tmp_path):
    for name in ("a.obj", "a.prj", "b.tif"):
        (tmp_path / name).write_text("old")
    return contents(tmp_path)


def test_a_batch_appears_when_it_is_left(tmp_path, old_files):
    with Batch() as batch:
        three_files(tmp_path, batch)
        shown = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
        assert shown == old_files
    assert contents(tmp_path) == dict.fromkeys(["a.obj", "b.tif", "c.json"], b"new")


@pytest.mark.parametrize("failure", [OSError("boom"), ValueError("boom"), KeyboardInterrupt()])
def test_a_failure_in_a_batch_leaves_all_as_it_was(tmp_path, old_files, failure):
    with pytest.raises((OutputError, type(failure))), Batch() as batch:
        three_files(tmp_path, batch)
        with atomic(tmp_path / "d.gpkg", batch=batch) as private:
            private.write_text("half")
            raise failure
    assert contents(tmp_path) == old_files


def test_a_file_of_a_batch_that_appears_meanwhile_stops_all(tmp_path, old_files):
    with pytest.raises(OutputError) as caught, Batch() as batch:
        three_files(tmp_path, batch)
        with atomic(tmp_path / "d.gpkg", batch=batch) as private:
            private.write_text("mine")
        (tmp_path / "d.gpkg").write_text("theirs")
    assert caught.value.code == "exists"
    assert contents(tmp_path) == {**old_files, "d.gpkg": b"theirs"}


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("stuck", ["a.obj", "b.tif", "c.json"])
@pytest.mark.parametrize("failure", [PermissionError(13, "in use"), KeyboardInterrupt()])
def test_a_file_that_cannot_be_replaced_brings_the_others_back(
    tmp_path, old_files, monkeypatch, stuck, links, failure
):
    def no_links(*names):
        raise PermissionError(1, "no links")

    replace_really = Path.replace

    def replace_file(source, target):
        if target.name == stuck and source.read_text() == "new":
            raise failure
        return replace_really(source, target)

    monkeypatch.setattr(Path, "replace", replace_file)
    if not links:
        monkeypatch.setattr(os, "link", no_links)
    with pytest.raises((OutputError, KeyboardInterrupt)), Batch() as batch:
        three_files(tmp_path, batch)
    if links:
        assert contents(tmp_path) == old_files
    else:  # whole, at least
        assert set(contents(tmp_path).values()) <= {b"old", b"new"}
        assert {"a.obj", "b.tif"} <= set(names(tmp_path))


def test_a_file_that_appears_meanwhile_is_not_overwritten(tmp_path):
    target = tmp_path / "a.obj"
    with pytest.raises(OutputError) as caught, atomic(target) as private:
        private.write_text("mine")
        target.write_text("theirs")
    assert caught.value.code == "exists"
    assert contents(tmp_path) == {"a.obj": b"theirs"}


def test_permissions_follow_the_umask_or_the_old_file(tmp_path):
    before = os.umask(0o022)
    try:
        write(grid_tin(), tmp_path / "a.gpkg")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.gpkg").stat().st_mode) == 0o644
    (tmp_path / "a.gpkg").chmod(0o664)
    write(grid_tin(), tmp_path / "a.gpkg", overwrite=True)
    assert stat.S_IMODE((tmp_path / "a.gpkg").stat().st_mode) == 0o664


def test_a_link_stays_and_the_file_it_names_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "b.obj", tmp_path / "a.obj"
    real.write_text("old")
    link.symlink_to(real)
    write(grid_tin(), link, overwrite=True)
    assert link.is_symlink()
    assert real.read_bytes().startswith(b"# TIN")
    assert names(tmp_path / "there") == ["b.obj"]


def test_a_long_name(tmp_path):
    name = "ü" * 125 + ".obj"
    write(grid_tin(), tmp_path / name)
    assert names(tmp_path) == [name]


def test_a_relative_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for suffix in SUFFIXES:
        check_outputs([f"a{suffix}"])
        write(grid_tin(), f"a{suffix}")
    assert names(tmp_path) == ["a.gpkg", "a.obj", "a.tif"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_existing_files_are_kept_unless_told(tmp_path, suffix):
    target = tmp_path / f"a{suffix}"
    target.write_text("old")
    assert code_of(write, grid_tin(), target) == "exists"
    assert contents(tmp_path) == {target.name: b"old"}
    write(grid_tin(), target, overwrite=True)
    assert target.stat().st_size > 1000


def test_a_prj_of_somebody_else_is_kept(tmp_path):
    (tmp_path / "a.prj").write_text("of a shapefile")
    assert code_of(write, grid_tin(crs=crs("EPSG:26710")), tmp_path / "a.obj") == "exists"
    assert names(tmp_path) == ["a.prj"]


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.6, 0.8, 0.95, 0.999])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_leaves_the_old_file(tmp_path, suffix, share, capfd):
    target = tmp_path / f"a{suffix}"
    tin = grid_tin(60, 60, crs=crs("EPSG:26710"))
    write(tin, target)
    before = contents(tmp_path)
    with file_size_limit(int(share * len(before[target.name]))):
        code = code_of(write, tin, target, overwrite=True)
    assert code == "write-failed"
    assert contents(tmp_path) == before
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".gpkg", ".tif"])
def test_a_crs_that_gdal_does_not_know(tmp_path, suffix, capfd):
    unknown = replace(crs("EPSG:26710"), code="EPSG:999999")
    assert code_of(write, grid_tin(crs=unknown), tmp_path / f"a{suffix}") == "write-failed"
    assert not names(tmp_path)
    assert capfd.readouterr() == ("", "")


def test_a_directory_that_may_not_be_written():
    directory = Path(tempfile.mkdtemp())
    try:
        directory.chmod(0o555)
        with ordinary_user():
            for suffix in SUFFIXES:
                assert code_of(write, grid_tin(), directory / f"a{suffix}") == "not-writable"
                assert code_of(check_outputs, [directory / f"a{suffix}"]) == "not-writable"
    finally:
        directory.rmdir()


def killed(program, *arguments, moment=0.0):
    """Run ``program`` until it prints a line, and ``moment`` seconds on; then kill -9."""
    root = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{root.parent}"}
    command = [sys.executable, "-c", program, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
        process.stdout.readline()
        time.sleep(moment)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL


def test_kill_in_the_middle_of_a_write(tmp_path):
    target = tmp_path / "a.obj"
    target.write_text("old")
    killed(
        "import sys, time; from pathlib import Path; from tin.formats.atomic import atomic\n"
        "with atomic(Path(sys.argv[1]), overwrite=True) as private:\n"
        "    private.write_text('half'); print(flush=True); time.sleep(60)\n",
        target,
    )
    stale = [path for path in tmp_path.iterdir() if path != target]
    assert [(path.name[:7], path.suffix) for path in stale] == [(".a.obj.", ".part")]
    assert target.read_text() == "old"
    write(grid_tin(), target, overwrite=True)
    assert set(tmp_path.iterdir()) == {target, *stale}


@pytest.mark.parametrize("moment", [0.02, 0.06, 0.12])
def test_kill_at_any_moment_leaves_the_old_file_or_the_new(tmp_path, moment):
    targets = {tmp_path / f"a{suffix}": b"old" for suffix in SUFFIXES}
    for target, old in targets.items():
        target.write_bytes(old)
    killed(
        "import sys; from fakes import grid_tin; from tin.formats import check_outputs, write\n"
        "check_outputs(sys.argv[1:], overwrite=True)\n"
        "tin = grid_tin(150, 150)\n"
        "print(flush=True)\n"
        "for path in sys.argv[1:] * 1000: write(tin, path, overwrite=True)\n",
        *targets,
        moment=moment,
    )
    tin = grid_tin(150, 150)
    for target, old in targets.items():
        if target.read_bytes() != old:
            whole = tmp_path / f"whole{target.suffix}"
            write(tin, whole)
            assert target.stat().st_size == whole.stat().st_size
            whole.unlink()
        write(tin, target, overwrite=True)
    assert [name for name in names(tmp_path) if not name.startswith(".")] == ["a.gpkg", "a.obj", "a.tif"]


def test_many_writers_of_one_file(tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    for suffix in (".obj", ".tif"):
        with ThreadPoolExecutor(4) as pool:
            list(
                pool.map(lambda _, s=suffix: write(grid_tin(), tmp_path / f"a{s}", overwrite=True), range(8))
            )
        write(grid_tin(), tmp_path / f"b{suffix}")
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_check_outputs_refuses_what_could_not_be_written(tmp_path, monkeypatch):
    dem = tmp_path / "dem.tif"
    dem.write_text("dem")
    (tmp_path / "dem.prj").write_text("crs")
    (tmp_path / "dir.obj").mkdir()
    (tmp_path / "link.tif").symlink_to(dem)
    good = [tmp_path / "a.gpkg", str(tmp_path / "a.obj"), tmp_path / "a.TIF"]
    check_outputs(good, inputs=[dem])
    assert code_of(check_outputs, [tmp_path / "a.shp"]) == "unknown-suffix"
    assert code_of(check_outputs, [tmp_path / "gpkg"]) == "unknown-suffix"
    assert code_of(check_outputs, [tmp_path / "no" / "a.obj"]) == "no-directory"
    assert code_of(check_outputs, [dem / "a.obj"]) == "no-directory"
    assert code_of(check_outputs, [dem]) == "exists"
    assert code_of(check_outputs, [tmp_path / "dir.obj"], overwrite=True) == "exists"
    assert code_of(check_outputs, [dem], inputs=[dem], overwrite=True) == "same-as-input"
    assert code_of(check_outputs, [tmp_path / "link.tif"], inputs=[dem], overwrite=True) == "same-as-input"
    assert code_of(check_outputs, [tmp_path / "dem.obj"], inputs=[dem], overwrite=True) == "same-as-input"
    assert code_of(check_outputs, [*good, tmp_path / "no" / ".." / "a.obj"]) == "duplicate-output"
    monkeypatch.setitem(WRITERS, ".xyz", Writer(print, "no_such_library", ()))
    assert code_of(check_outputs, [tmp_path / "a.xyz"]) == "missing-library"
    assert names(tmp_path) == ["dem.prj", "dem.tif", "dir.obj", "link.tif"]


def test_an_unknown_option_is_named(tmp_path):
    with pytest.raises(OptionError, match="has no option y_up") as caught:
        write(grid_tin(), tmp_path / "a.tif", y_up=True)
    assert caught.value.code == "unknown-option"
    assert not names(tmp_path)


def test_only_the_options_of_a_format_are_accepted():
    assert formats.accepted("a.obj", {"y_up": True, "colour": 1}) == {"y_up": True}
    assert formats.accepted("a.gpkg", {"y_up": True}) == {}


def test_text_is_written_with_the_same_care(tmp_path):
    formats.write_text(tmp_path / "a.json", "é")
    assert code_of(formats.write_text, tmp_path / "a.json", "b") == "exists"
    assert code_of(formats.write_text, tmp_path / "no" / "a.json", "b") == "no-directory"
    assert contents(tmp_path) == {"a.json": "é".encode()}


def test_importing_the_formats_imports_numpy_alone():
    program = "import sys, tin.formats; print({'rasterio', 'pyogrio', 'shapely'} & sys.modules.keys())"
    root = Path(formats.__file__).parents[2]
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    assert result.stdout == "set()\n"
