"""The door to object storage: objects written, read in ranges and listed by key, through `obstore`. Knows no datasets.

An object that is not there is a `FileNotFoundError`, one that is there already a `FileExistsError`; all else is a
`WorldError` that names the place, what was found and the remedy. Credentials come from the environment, never from a
URL, and no message of ours repeats what a server said but its code.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import TYPE_CHECKING, Any, NamedTuple

from schemas.errors import UsageError, WorldError
from schemas.support.extras import missing_package

if TYPE_CHECKING:
    from obstore.store import ClientConfig, RetryConfig
    from typing_extensions import Buffer

__all__ = ["SCHEMES", "Listed", "Objects", "objects_at"]

SCHEMES = ("s3", "gs", "az")
_CLIENT: ClientConfig = {"connect_timeout": "5s", "timeout": "10m", "allow_http": True}
"""An endpoint that the user writes as http:// is taken at its word; a bundle may take minutes on a slow line."""
_RETRY: RetryConfig = {"max_retries": 5, "retry_timeout": timedelta(seconds=60)}
_BATCH = 1000
_COPY_BYTES = 1 << 20
_STATUS = re.compile(r"status code: (\d{3} [A-Za-z ]+)")
_CODE = re.compile(r"<Code>(\w{1,64})</Code>")
_ASKED_THE_CLOUD = ("latest/api/token", "latest/meta-data", "computeMetadata", "metadata/identity")
"""Where machines of a cloud ask for credentials, which they do only when none were given."""
_REMEDIES = (
    ("NoSuchBucket", "create the bucket, or check its name and AWS_ENDPOINT_URL"),
    ("no credentials", "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or your cloud's own variables"),
    ("401", "check the credentials in the environment"),
    ("403", "check the credentials in the environment, and that they may read, write, list and delete there"),
    ("501", "use a store that supports conditional writes (If-None-Match), so that no episode is overwritten"),
    ("cannot be reached", "check the network and AWS_ENDPOINT_URL, then try again"),
)


class Listed(NamedTuple):
    """An object, as a list or its head says."""

    key: str
    size: int


@functools.cache
def objects_at(url: str) -> Objects:
    """Returns the objects below a URL; one of them a process, however often it is asked for."""
    return Objects(url)


class Objects:
    """The objects below a URL such as `s3://bucket/run`; may be used from several threads, but not after a fork.

    Raises:
        UsageError: the URL cannot be understood, or `obstore` is not installed.
    """

    def __init__(self, url: str) -> None:
        self.url = _checked(url)
        self._store = _open(self.url)

    def put_new(self, key: str, data: Buffer) -> None:
        """Writes an object in one request that fails when it is there already; nothing of it shows before it is whole.

        Raises:
            FileExistsError: an object of that key is there; it is left as it is.
        """
        self._put(key, data, "create")

    def put(self, key: str, data: Buffer) -> None:
        """Writes an object in the place of a former one; readers see the one or the other, whole."""
        self._put(key, data, "overwrite")

    def _put(self, key: str, data: Buffer, mode: str) -> None:
        # one request, not several parts: only a single put can be conditional, and it leaves no parts behind
        self._call("write", key, lambda door, store: door.put(store, key, data, mode=mode, use_multipart=False))

    def read(self, key: str) -> bytes:
        """Returns an object whole; meant for small ones."""
        return b"".join(self.stream(key))

    def stream(self, key: str) -> Iterator[bytes]:
        """Yields an object piece by piece."""
        answer = self._call("read", key, lambda door, store: door.get(store, key))
        pieces = iter(answer.stream(min_chunk_size=_COPY_BYTES))
        while (piece := self._call("read", key, lambda _door, _store: next(pieces, None))) is not None:
            yield bytes(piece)

    def read_range(self, key: str, start: int, end: int) -> bytes:
        """Returns the bytes from `start` up to, not including, `end`."""
        return bytes(self._call("read", key, lambda door, store: door.get_range(store, key, start=start, end=end)))

    def head(self, key: str) -> Listed:
        """Returns an object's size."""
        return Listed(key, self._call("read", key, lambda door, store: door.head(store, key))["size"])

    def walk(self, folder: str) -> Iterator[Listed]:
        """Yields all objects below a folder, in any depth."""
        batches = iter(self._call("list", folder, lambda door, store: door.list(store, folder, chunk_size=_BATCH)))
        while (batch := self._call("list", folder, lambda _door, _store: next(batches, None))) is not None:
            yield from (Listed(found["path"], found["size"]) for found in batch)

    def list_folder(self, folder: str) -> tuple[list[str], list[Listed]]:
        """Returns the folders directly in a folder, by their keys, and the objects."""
        found = self._call("list", folder, lambda door, store: door.list_with_delimiter(store, folder or None))
        return list(found["common_prefixes"]), [Listed(item["path"], item["size"]) for item in found["objects"]]

    def copy(self, key: str, to: str) -> None:
        """Copies an object within the store."""
        self._call("copy", key, lambda door, store: door.copy(store, key, to))

    def delete(self, key: str) -> None:
        """Deletes an object; does nothing when there is none."""
        with contextlib.suppress(FileNotFoundError):
            self._call("delete", key, lambda door, store: door.delete(store, key))

    def _call(self, what: str, key: str, action: Callable[[Any, Any], Any]) -> Any:
        import obstore
        from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError

        _require_own_process(self.url)
        place = f"{self.url}/{key}"
        try:
            return action(obstore, self._store)
        except (AlreadyExistsError, PreconditionError):
            raise FileExistsError(errno.EEXIST, "already exists", place) from None
        # the door's own errors may quote requests with their signatures, so that none is chained to ours
        except FileNotFoundError as error:
            if "NoSuchBucket" not in str(error):
                raise FileNotFoundError(errno.ENOENT, "no such object", place) from None
            raise _world_error(what, place, str(error)) from None
        except BaseError as error:
            raise _world_error(what, place, str(error)) from None

    def __reduce__(self) -> tuple[Callable[[str], Objects], tuple[str]]:
        return objects_at, (self.url,)


_users: list[int] = []
"""The process that has used a store first."""


def _require_own_process(url: str) -> None:
    """The threads that carry requests do not survive a fork: without them a request would wait for ever."""
    if not _users:
        _users.append(os.getpid())
    if os.getpid() not in _users:
        raise UsageError(
            f"{url} cannot be read after a fork of a process that has read it: start processes with the method "
            "spawn, e.g. "
            "DataLoader(..., multiprocessing_context='spawn')"
        )


def _checked(url: str) -> str:
    scheme, _, rest = url.rstrip("/").partition("://")
    if scheme not in SCHEMES or not rest or any(mark in rest for mark in "?#") or ".." in rest.split("/"):
        raise UsageError(
            f"{_shown(url)!r} is not a valid location of a dataset: give a directory, or {'://, '.join(SCHEMES)}://BUCKET/NAME"
        )
    if "@" in rest:
        raise UsageError(f"{_shown(url)!r}: a URL must not contain credentials; they are read from the environment")
    return f"{scheme}://{rest}"


def _shown(url: str) -> str:
    """Returns a URL without what might be a password or a signature."""
    return re.sub(r"//[^/]*@", "//...@", url).split("?")[0]


def _open(url: str) -> Any:
    try:
        from obstore.exceptions import BaseError
        from obstore.store import from_url
    except ImportError as error:
        raise missing_package("obstore", f"an archive in object storage ({url})") from error
    try:
        return from_url(url, client_options=_CLIENT, retry_config=_RETRY)
    except (BaseError, ValueError) as error:
        said = str(error).split("\n")[0]
        raise UsageError(f"cannot open {url}: {said}; set the environment variables of your cloud provider") from None


def _world_error(what: str, place: str, said: str) -> WorldError:
    found = _found(said)
    remedy = next((remedy for mark, remedy in _REMEDIES if mark in found), "look after the store, then try again")
    return WorldError(f"cannot {what} {place}: {found}; {remedy}")


def _found(said: str) -> str:
    """Returns what happened, in words of ours and the server's code; the rest of its answer may hold secrets."""
    if any(path in said for path in _ASKED_THE_CLOUD):
        return "no credentials were found"
    status, code = _STATUS.search(said), _CODE.search(said)
    if status is not None:
        return f"the store answers {status[1].strip()}{f' ({code[1]})' if code is not None else ''}"
    if "HTTP error" in said or "error sending request" in said:
        return "the store cannot be reached"
    return said.split(" error: ", 1)[0].split("\n")[0]
