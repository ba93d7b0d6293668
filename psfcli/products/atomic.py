"""The one way products reach a directory: complete temporaries first, then renames, the manifest last."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from mmap import ACCESS_READ, MADV_DONTNEED, mmap
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from concurrent.futures import Future
    from pathlib import Path

TEMPORARY = ".psfcli-unfinished-"
_MAPPED = 1 << 25  # bytes of a file in memory at a time

_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file would exceed the file-size limit (see ulimit -f)",
    errno.EACCES: "no permission to write",
    errno.EPERM: "no permission to write",
    errno.EROFS: "the file system is read-only",
    errno.ENOTDIR: "a part of the path is a file, not a directory",
}

_locks: set[int] = set()


def _drop_inherited_locks() -> None:
    """Close the locks a forked worker inherits: else an orphan would hold the directory after its run was killed."""
    for descriptor in _locks:
        os.close(descriptor)
    _locks.clear()


os.register_at_fork(after_in_child=_drop_inherited_locks)


class OutputError(Exception):
    """The products cannot be written where they were asked for; one line that says why."""


@contextmanager
def output_errors(place: Path) -> Iterator[None]:
    """Turn each OSError of the block into an OutputError of one line that names the file, or else ``place``."""
    try:
        yield
    except OSError as fault:
        reason = _REASONS.get(fault.errno or 0, fault.strerror or str(fault))
        name = str(fault.filename or place).replace(TEMPORARY, "")
        raise OutputError(f"{name}: {reason}") from fault


class Stage:
    """New files of ``directory``, invisible until ``commit`` puts all of them in place.

    Makes the directory and its parents, keeps other runs out of it, and removes the temporaries of killed runs.
    Raises OSError, and OutputError when another run is writing there.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._made = [p for p in (directory, *directory.parents) if not p.exists()]
        self._streams: dict[str, BinaryIO] = {}
        self._scratch: list[BinaryIO] = []
        self._sealed: dict[str, Future[str] | None] = {}
        self._threads = ThreadPoolExecutor()
        directory.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        _locks.add(self._lock)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._release()
            raise OutputError(f"{directory}: another run is writing there") from None
        except OSError:
            pass  # some network file systems have no locks; a lone run needs none
        self._remove_temporaries()

    def path(self, name: str) -> Path:
        """Where the temporary of product ``name`` lies."""
        return self.directory / f"{TEMPORARY}{name}"

    def announce(self, name: str) -> Path:
        """Where the temporary of product ``name`` has to be when it is sealed."""
        self._sealed[name] = None
        return self.path(name)

    def open(self, name: str) -> BinaryIO:
        """A new temporary of product ``name``, to be written and read; ``seal`` or ``close`` closes it."""
        stream = self._streams[name] = self.announce(name).open("w+b")
        return stream

    def scratch(self) -> BinaryIO:
        """A file without a name, to be written and read; gone with the stage or with a kill."""
        stream = TemporaryFile(dir=self.directory)  # noqa: SIM115 - closed with the stage
        self._scratch.append(stream)
        return stream

    def seal(self, name: str) -> None:
        """Put product ``name`` on the disk and hash it, while other work goes on; both leave Python's lock."""
        if name in self._streams:
            self._streams.pop(name).close()
        self._sealed[name] = self._threads.submit(_synchronised_sha256, self.path(name))

    def digests(self) -> dict[str, str]:
        """The sha256 of each product by name, as announced; all their bytes are on the disk when this returns."""
        for name in list(self._streams):
            self.seal(name)
        return {name: task.result() for name, task in self._sealed.items() if task is not None}

    def commit(self, last: str, content: bytes, obsolete: Iterable[str] = ()) -> None:
        """Put every sealed product in its place, remove the ``obsolete`` files, and write the file ``last``.

        The old ``last`` goes before anything else changes and the new one comes after everything else, so its
        presence says that the directory is whole.
        """
        names = list(self._sealed)
        self.path(last).write_bytes(content)
        _synchronise(self.path(last))
        (self.directory / last).unlink(missing_ok=True)
        os.fsync(self._lock)
        for name in names:
            self.path(name).replace(self.directory / name)
        for name in obsolete:
            (self.directory / name).unlink(missing_ok=True)
        os.fsync(self._lock)
        self.path(last).replace(self.directory / last)
        os.fsync(self._lock)

    def close(self) -> None:
        """Let other runs in; what was not committed is removed, with the directories made for it."""
        self._threads.shutdown(cancel_futures=True)
        for stream in (*self._streams.values(), *self._scratch):
            with suppress(OSError):  # closing flushes once more, and fails again where writing failed
                stream.close()
        with suppress(OSError):
            self._remove_temporaries()
        self._release()
        with suppress(OSError):  # a directory that has something in it stays
            for directory in self._made:
                directory.rmdir()

    def _remove_temporaries(self) -> None:
        for left in self.directory.glob(f"{TEMPORARY}*"):
            left.unlink()

    def _release(self) -> None:
        if self._lock in _locks:
            _locks.remove(self._lock)
            os.close(self._lock)


def _synchronise(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _synchronised_sha256(path: Path) -> str:
    _synchronise(path)
    # in few calls, for every call that returns to Python waits for its lock; the pages read are given back at once
    digest = hashlib.sha256()
    with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as content:
        for start in range(0, len(content), _MAPPED):
            with memoryview(content) as whole, whole[start : start + _MAPPED] as part:
                digest.update(part)
            content.madvise(MADV_DONTNEED)
    return digest.hexdigest()
