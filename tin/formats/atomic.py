"""Write a file so that its name never stands for half of one.

Everything is written in a private directory beside the target, brought to disk,
and only then renamed: whenever a run fails or is killed, the old files are there
or the new ones. A killed run may leave its directory ``.NAME.xxxxxxxx.part``,
which no later run looks at and anybody may delete.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from tin.errors import OutputError, TinError


@contextlib.contextmanager
def atomic(target: Path, *, overwrite: bool = False, companions: Sequence[Path] = ()) -> Iterator[Path]:
    """Yield the private path to write; leaving the block puts it in place of ``target``.

    Other files written beside it go along. ``companions`` are the files that belong to
    ``target`` (a ``.prj``, an SQLite journal): they guard it against overwriting as it does
    itself, and those of an older ``target`` that are not written anew are removed with it.
    ``target`` is an absolute path without symbolic links.

    Raises OutputError: ``exists``, ``no-directory``, ``not-writable``, or ``write-failed`` for
    any OSError inside the block. Whatever else is raised passes, with everything cleaned up.
    """
    refuse_existing(target, companions, overwrite=overwrite)
    private = _private_directory(target)
    try:
        yield private / target.name
        refuse_existing(target, companions, overwrite=overwrite)
        _commit(private, target, companions)
    except TinError:
        raise
    except OSError as error:
        reason = " ".join((error.strerror or str(error)).replace(str(private), str(target.parent)).split())
        message = f"{target}: cannot be written: {reason}; what was there before is untouched"
        raise OutputError("write-failed", message) from error
    finally:
        shutil.rmtree(private, ignore_errors=True)


def refuse_existing(target: Path, companions: Sequence[Path], *, overwrite: bool) -> None:
    """Raise OutputError ``exists`` for a file in the way, unless it may be overwritten."""
    for path in (target, *companions):
        try:
            path.lstat()
        except (FileNotFoundError, NotADirectoryError):
            continue  # what is wrong with the directory is found by trying
        except OSError as error:
            message = f"{target}: not a name that can be written to: {error.strerror}"
            raise OutputError("not-writable", message) from error
        if path.exists() and not path.is_file():
            raise OutputError("exists", f"{path}: exists and is not a file; choose another name")
        if path.exists() and not overwrite:
            raise OutputError("exists", f"{path}: exists already; choose another name or ask to overwrite it")


def check_writable(target: Path) -> None:
    """Raise OutputError unless a file can be made beside ``target``; found out by trying."""
    _private_directory(target).rmdir()


def _private_directory(target: Path) -> Path:
    # A plain and short name: GDAL reads a meaning into some characters, and names end at 255 bytes.
    plain = re.sub(r"[^\w.-]", "_", target.name)[:40]
    try:
        return Path(tempfile.mkdtemp(prefix=f".{plain}.", suffix=".part", dir=target.parent))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise OutputError("no-directory", f"{target}: there is no directory {target.parent}") from error
    except OSError as error:
        message = f"{target}: cannot write in the directory {target.parent}: {error.strerror}"
        raise OutputError("not-writable", message) from error


def _commit(private: Path, target: Path, companions: Sequence[Path]) -> None:
    written = private / target.name
    beside = [path for path in private.iterdir() if path != written]
    if target.exists():
        shutil.copymode(target, written)
    for path in (written, *beside):
        with path.open("rb+") as file:
            os.fsync(file.fileno())
    # Stale companions go first: an old SQLite journal beside a new database would corrupt it.
    for path in companions:
        if private / path.name not in beside:
            path.unlink(missing_ok=True)
    for path in (*beside, written):
        path.replace(target.parent / path.name)
    _sync_directory(target.parent)


def _sync_directory(directory: Path) -> None:
    # The files are in place; a system that cannot sync a directory (Windows, some shares) is no failure.
    with contextlib.suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
