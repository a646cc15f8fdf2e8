"""Write a file so that its name never stands for half of one.

Everything is written in a private directory beside the target, brought to disk,
and only then renamed, all files of a batch at the end. A run that fails leaves the old
files; one that is killed leaves of each the old or the new, and perhaps its directory
``.NAME.xxxxxxxx.part``, which no later run looks at and anybody may delete.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from tin.errors import OutputError, TinError


class Batch:
    """Files that are put in place together when the block is left, or, if anything fails, none of them.

    Raises OutputError on leaving: ``exists`` or ``write-failed``.
    """

    def __init__(self) -> None:
        self.files: list[_File] = []
        """What is ready and waits in its private directory."""
        self.cleaning = contextlib.ExitStack()

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self.cleaning:
            if kind is None:
                self._put_in_place()

    def _put_in_place(self) -> None:
        for file in self.files:
            refuse_existing(file.target, file.companions, overwrite=file.overwrite)
        with contextlib.ExitStack() as undo:
            for file in self.files:
                with _reported(file.private, file.target):
                    _put_in_place(file, undo)
            undo.pop_all()


class _File(NamedTuple):
    private: Path
    target: Path
    companions: Sequence[Path]
    overwrite: bool


@contextlib.contextmanager
def atomic(
    target: Path, *, overwrite: bool = False, companions: Sequence[Path] = (), batch: Batch | None = None
) -> Iterator[Path]:
    """Yield the private path to write; leaving the block puts it in place of ``target``.

    Other files written beside it go along. ``companions`` are the files that belong to
    ``target`` (a ``.prj``, an SQLite journal): they guard it against overwriting as it does
    itself, and those of an older ``target`` that are not written anew are removed with it.
    ``target`` is an absolute path without symbolic links. With a ``batch`` nothing is put in
    place before all that is in it.

    Raises OutputError: ``exists``, ``no-directory``, ``not-writable``, or ``write-failed`` for
    any OSError inside the block. Whatever else is raised passes, with everything cleaned up.
    """
    refuse_existing(target, companions, overwrite=overwrite)
    with contextlib.nullcontext(batch) if batch is not None else Batch() as files:
        private = _private_directory(target)
        files.cleaning.callback(shutil.rmtree, private, ignore_errors=True)
        with _reported(private, target):
            yield private / target.name
            _bring_to_disk(private, target)
        files.files.append(_File(private, target, companions, overwrite))


@contextlib.contextmanager
def _reported(private: Path, target: Path) -> Iterator[None]:
    """Make an OutputError of an OSError, which knows nothing of the private directory."""
    try:
        yield
    except TinError:
        raise
    except OSError as error:
        reason = " ".join((error.strerror or str(error)).replace(str(private), str(target.parent)).split())
        message = f"{target}: cannot be written: {reason}; what was there before is untouched"
        raise OutputError("write-failed", message) from error


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


def _bring_to_disk(private: Path, target: Path) -> None:
    if target.exists():
        shutil.copymode(target, private / target.name)
    for path in {private / target.name, *private.iterdir()}:
        with path.open("rb+") as file:
            os.fsync(file.fileno())


def _put_in_place(file: _File, undo: contextlib.ExitStack) -> None:
    written = {path.name: path for path in file.private.iterdir()}
    kept = Path(tempfile.mkdtemp(dir=file.private))
    last = written.pop(file.target.name)
    # Stale companions go first: an old SQLite journal beside a new database would corrupt it.
    for path in file.companions:
        if path.name not in written and path.exists():
            undo.callback(_restore, path, _keep(path, kept))
            path.unlink()
    for path in (*written.values(), last):
        target = file.target.parent / path.name
        undo.callback(_restore, target, _keep(target, kept))
        path.replace(target)
    _sync_directory(file.target.parent)


def _keep(path: Path, directory: Path) -> Path | None:
    """Return a second name for an old file, None if there is none."""
    kept = directory / path.name
    try:
        os.link(path, kept)
    except FileNotFoundError:
        return None
    except (OSError, NotImplementedError):
        return path  # a file system without links: the new file would have to stay
    return kept


def _restore(path: Path, kept: Path | None) -> None:
    with contextlib.suppress(OSError):
        if kept is None:
            path.unlink(missing_ok=True)
        else:
            kept.replace(path)


def _sync_directory(directory: Path) -> None:
    # The files are in place; a system that cannot sync a directory (Windows, some shares) is no failure.
    with contextlib.suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
