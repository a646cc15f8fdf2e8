"""Full disks, directories that may not be written, and outputs on another file system."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from terrain import dem

import tin
from tin import formats
from tin.errors import OutputError

ROOT = Path(__file__).parents[1]
JACKSBORO = ROOT / "sample_dem" / "jacksboro.dem"
SHM = Path("/dev/shm")
OLD = b"what was there before\n"
TEXT = "a report\n" * 3000


@pytest.fixture(scope="module")
def mesh() -> tin.Tin:
    made = tin.triangulate(dem(400, 500, crs="EPSG:32610", name="hills"), max_points=4000)
    made.plot()  # fonts and the like are cached now, before any limit
    return made


Write = Callable[..., None]
WRITES: dict[str, Write] = {
    **{f"x{suffix}": formats.write for suffix in formats.WRITERS},
    "error_map.tif": formats.write_error_map,
    "report.json": lambda mesh, path, **keywords: formats.write_text(path, TEXT, **keywords),
}
each_writer = pytest.mark.parametrize("name", WRITES)
# A picture takes seconds, so that one share must do.
each_share = pytest.mark.parametrize(
    ("name", "share"),
    [(name, share) for name in WRITES for share in (0.0, 0.5, 0.9) if name != "x.png" or share == 0.5],
)


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def refused(code: str, name: str, mesh: tin.Tin, path: Path, **keywords: object) -> str:
    with pytest.raises(OutputError) as caught:
        WRITES[name](mesh, path, **keywords)
    message = str(caught.value)
    assert caught.value.code == code, message
    assert str(path) in message
    assert "\n" not in message
    assert ".part" not in message
    return message


@pytest.fixture(scope="module")
def sizes(mesh, tmp_path_factory) -> dict[str, int]:
    """The bytes of what each writer writes."""
    apart = tmp_path_factory.mktemp("whole")
    for name, write in WRITES.items():
        write(mesh, apart / name)
    return {name: (apart / name).stat().st_size for name in WRITES}


@contextlib.contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@each_share
def test_a_file_that_may_not_grow(tmp_path, mesh, sizes, name, share, capfd):
    limit = int(share * sizes[name])
    with file_size_limit(limit):
        refused("write-failed", name, mesh, tmp_path / name)
    assert contents(tmp_path) == {}
    (tmp_path / name).write_bytes(OLD)
    with file_size_limit(limit):
        refused("write-failed", name, mesh, tmp_path / name, overwrite=True)
    assert contents(tmp_path) == {name: OLD}
    assert capfd.readouterr() == ("", "")


@pytest.fixture(scope="module")
def small_disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A file system of 8 MiB in memory, where this user may mount one."""
    point = tmp_path_factory.mktemp("disk")
    mount = shutil.which("mount")
    command = [mount, "-t", "tmpfs", "-o", "size=8m,mode=755", "tmpfs", point]
    if os.geteuid() != 0 or mount is None or subprocess.run(command, stderr=-3, check=False).returncode:
        pytest.skip("only root may mount a file system to fill, and not in every container")
    yield point
    subprocess.run(["umount", point], check=True)


def fill(disk: Path, free: int) -> Path:
    """Leave ``free`` bytes of the disk, to whole pages."""
    filler = disk / "filler"
    pages = os.statvfs(disk)
    filler.write_bytes(bytes(max(0, pages.f_bavail * pages.f_frsize - free)))
    return filler


@each_share
def test_a_full_disk(small_disk, mesh, sizes, name, share, capfd):
    target = small_disk / name
    target.write_bytes(OLD)
    filler = fill(small_disk, int(share * sizes[name]))
    refused("write-failed", name, mesh, target, overwrite=True)
    filler.unlink()
    assert contents(small_disk) == {name: OLD}
    assert capfd.readouterr() == ("", "")
    WRITES[name](mesh, target, overwrite=True)
    assert target.stat().st_size > len(OLD)
    for path in small_disk.iterdir():
        path.unlink()


def command(*arguments: object, limit: int | None = None, **keywords: object) -> subprocess.CompletedProcess:
    program = (
        "import resource, sys\nfrom tin.cli import main\n"
        "if sys.argv[1] != 'None':\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)\n"
        "sys.exit(main(sys.argv[2:]))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **keywords.pop("env", {})}
    line = [sys.executable, "-c", program, str(limit), *map(str, arguments)]
    return subprocess.run(line, env=environment, capture_output=True, text=True, check=False, **keywords)


@pytest.mark.parametrize(
    ("outputs", "limit"),
    [
        (["x.gpkg"], 60_000),
        (["x.obj", "--json", "r.json"], 0),
        (["x.tif", "--error-map", "e.tif"], 0),
        (["x.png"], 10_000),
    ],
    ids=["gpkg", "obj", "tif", "png"],
)
def test_a_full_disk_on_the_command_line(tmp_path, outputs, limit):
    for name in outputs:
        if "." in name:
            (tmp_path / name).write_bytes(OLD)
    before = contents(tmp_path)
    done = command(JACKSBORO, *outputs, "--overwrite", limit=limit, cwd=tmp_path)
    assert done.returncode == 4, done.stderr
    assert done.stdout == ""
    assert done.stderr.startswith(f"dem2tin: {tmp_path / outputs[0]}: cannot be written: ")
    assert done.stderr.count("\n") == 1
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "outputs", [["x.obj", "x.tif"], ["x.obj", "--error-map", "e.tif"], ["x.obj", "--outline", "o.gpkg"]]
)
@pytest.mark.parametrize("has_old", [True, False])
def test_what_was_written_before_a_failure_does_not_appear(tmp_path, outputs, has_old):
    if has_old:
        for name in (*(name for name in outputs if "." in name), "x.prj", "r.json"):
            (tmp_path / name).write_bytes(OLD)
    before = contents(tmp_path)
    options = ["--max-points", "50", "--json", "r.json", "--overwrite"]
    done = command(JACKSBORO, *outputs, *options, limit=60_000, cwd=tmp_path)
    assert done.returncode == 4, done.stderr
    assert done.stderr.startswith(f"dem2tin: {tmp_path / outputs[-1]}: cannot be written: ")
    assert contents(tmp_path) == before


@each_writer
def test_a_directory_that_may_not_be_written(name, mesh):
    directory = Path(tempfile.mkdtemp())  # unlike tmp_path, anybody may look into what it is in
    try:
        directory.chmod(0o555)
        if os.geteuid() == 0:  # root may write anywhere
            os.seteuid(65534)
        refused("not-writable", name, mesh, directory / name)
        assert contents(directory) == {}
    finally:
        os.seteuid(os.getuid())
        directory.rmdir()


@pytest.fixture
def elsewhere(tmp_path) -> Iterator[Path]:
    """A directory on another file system than ``tmp_path``."""
    if not SHM.is_dir() or SHM.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("needs /dev/shm on a file system of its own")
    directory = Path(tempfile.mkdtemp(dir=SHM))
    yield directory
    shutil.rmtree(directory)


@pytest.mark.parametrize("by_link", [False, True], ids=["path", "link"])
def test_outputs_on_another_file_system_than_all_else(tmp_path, elsewhere, by_link):
    names = [f"x{suffix}" for suffix in formats.WRITERS]
    places = []
    for name in [*names, "e.tif", "r.json"]:
        place = elsewhere / name
        if by_link:
            place.write_bytes(OLD)
            place = tmp_path / name
            place.symlink_to(elsewhere / name)
        places.append(place)
    *outputs, error_map, report = places
    where = {"cwd": tmp_path, "env": {"TMPDIR": str(tmp_path)}}
    extra = ["--error-map", error_map, "--json", report, "--overwrite"]
    done = command(JACKSBORO, *outputs, *extra, "--max-points", "50", **where)
    assert (done.returncode, done.stderr) == (0, "")
    written = contents(elsewhere)
    assert sorted(written) == sorted([*names, "e.tif", "r.json", "x.prj"])
    assert OLD not in written.values()
    assert json.loads(written["r.json"])["points"] == 50
    assert all(place.is_symlink() == by_link for place in places)
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and not path.is_symlink()]


def test_a_link_to_a_file_that_is_not_there_yet(tmp_path, elsewhere, mesh):
    for name, write in WRITES.items():
        (tmp_path / name).symlink_to(elsewhere / name)
        write(mesh, tmp_path / name)
        assert (tmp_path / name).is_symlink()
    assert {*WRITES} <= contents(elsewhere).keys()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(WRITES)
