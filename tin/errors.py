"""The errors of dem2tin: one base class, and a stable code on every instance.

Each subclass also inherits the built-in exception a caller would expect, so
``except ValueError`` and ``except OSError`` keep working.
"""

from __future__ import annotations


class TinError(Exception):
    """Base of every error raised on purpose; ``code`` is stable across releases."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message

    def __str__(self) -> str:
        return self.message

    def __reduce__(self) -> tuple[type[TinError], tuple[str, str]]:
        return type(self), (self.code, self.message)


class InputError(TinError, ValueError):
    """The DEM, or another input, cannot be used."""


class OptionError(TinError, ValueError):
    """An option has a value outside its bounds, or options contradict each other."""


class OutputError(TinError, OSError):
    """An output could not be written; files that were there before are untouched."""


class Cancelled(TinError):
    """The progress callback asked to stop."""

    def __init__(self, code: str = "cancelled", message: str = "cancelled") -> None:
        super().__init__(code, message)
