"""Errors, with the text that the command prints."""

from __future__ import annotations


class Error(Exception):
    """Something went wrong; the text is the one that the command prints.

    `code` is the exit code that the command would have.
    """

    code: int = 1


class UsageError(Error, ValueError):
    """A mistake in a manifest or in what was given; nothing ran."""

    code = 2


class DataError(Error):
    """Input data could not be read, or failed a check."""

    code = 3


class RunError(Error):
    """A node failed; what was finished stays in the cache."""


class InternalError(Error, RuntimeError):
    """A mistake of this package: a panic that was caught."""

    code = 255


def of(code: int, text: str) -> BaseException:
    """The exception for an exit code of the command and what it printed to stderr."""
    if code == 130:
        return KeyboardInterrupt(text)
    kinds: dict[int, type[Error]] = {2: UsageError, 3: DataError, 255: InternalError}
    error = kinds.get(code, RunError)(text)
    error.code = code
    return error
