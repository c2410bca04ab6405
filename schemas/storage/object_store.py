"""Client of object storage: writes, reads, lists, copies and deletes objects with `obstore`. Independent of datasets.

Raises `FileNotFoundError` for a missing object, `FileExistsError` for an existing one, and `WorldError` for all other
failures, with URL, cause and remedy. Credentials are read from the environment, not from a URL. Error messages repeat
the status code of a server's answer, but not its text.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from typing import TYPE_CHECKING, Any, NamedTuple

from schemas.errors import UsageError, WorldError
from schemas.support.extras import missing_package

if TYPE_CHECKING:
    from obstore.store import ClientConfig, RetryConfig
    from typing_extensions import Buffer

SCHEMES = ("s3", "gs", "az")
_CLIENT: ClientConfig = {"connect_timeout": "5s", "timeout": "10m", "allow_http": True}
"""Client options: `http://` endpoints are allowed, and the timeout suits a bundle on a slow connection."""
_RETRY: RetryConfig = {"max_retries": 5, "retry_timeout": timedelta(seconds=60)}
_BATCH = 1000
_COPY_BYTES = 1 << 20
_STATUS = re.compile(r"status code: (\d{3} [A-Za-z ]+)")
_CODE = re.compile(r"<Code>(\w{1,64})</Code>")
_METADATA_SERVICES = ("latest/api/token", "latest/meta-data", "computeMetadata", "metadata/identity")
"""URLs of cloud metadata services; `obstore` requests credentials there only if the environment has none."""
_REMEDIES = (
    ("NoSuchBucket", "create the bucket, or check its name and AWS_ENDPOINT_URL"),
    ("no credentials", "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or your cloud's own variables"),
    ("RequestTimeTooSkewed", "set the clock of this host; stores accept a difference of some minutes"),
    ("401", "check the credentials in the environment"),
    ("403", "check the credentials in the environment, and that they may read, write, list and delete there"),
    ("501", "use a store that supports conditional writes (If-None-Match), so no episode is overwritten"),
    ("cannot be reached", "check the network and AWS_ENDPOINT_URL, then try again"),
)


class Listed(NamedTuple):
    """Entry of a listing."""

    key: str
    """Key of the object."""
    size: int
    """Size of the object, bytes."""


@functools.cache
def objects_at(url: str) -> Objects:
    """Returns the client for a URL; in one process, all calls with the same URL return the same client."""
    return Objects(url)


class Objects:
    """Client of the objects below a URL such as `s3://bucket/run`; safe to use from several threads, not after a fork.

    Raises:
        UsageError: the URL is not valid, or `obstore` is not installed.
    """

    def __init__(self, url: str) -> None:
        self.url = _checked(url)
        self._store = _open(self.url)

    def put_new(self, key: str, data: Buffer) -> None:
        """Writes a new object in one request; the object becomes visible when it is complete.

        Raises:
            FileExistsError: an object of that key exists; it is not changed.
        """
        self._put(key, data, "create")

    def put(self, key: str, data: Buffer) -> None:
        """Writes an object or replaces an existing one; readers see either version complete."""
        self._put(key, data, "overwrite")

    def _put(self, key: str, data: Buffer, mode: str) -> None:
        # one request instead of a multipart upload: only a single put can be conditional, and it leaves no parts behind
        self._call("write", key, lambda api, store: api.put(store, key, data, mode=mode, use_multipart=False))

    def read(self, key: str) -> bytes:
        """Returns the content of a small object."""
        return b"".join(self.stream(key))

    def stream(self, key: str) -> Iterator[bytes]:
        """Yields the content of an object in pieces."""
        answer = self._call("read", key, lambda api, store: api.get(store, key))
        pieces = iter(answer.stream(min_chunk_size=_COPY_BYTES))
        while (piece := self._call("read", key, lambda _api, _store: next(pieces, None))) is not None:
            yield bytes(piece)

    def read_range(self, key: str, start: int, end: int) -> bytes:
        """Returns the bytes from `start` to `end`, `end` excluded."""
        return bytes(self._call("read", key, lambda api, store: api.get_range(store, key, start=start, end=end)))

    def head(self, key: str) -> Listed:
        """Returns the key and size of an object."""
        return Listed(key, self._call("read", key, lambda api, store: api.head(store, key))["size"])

    def walk(self, folder: str, after: str | None = None) -> Iterator[Listed]:
        """Yields all objects below a folder, recursively; with `after` only those with greater keys."""
        batches = iter(
            self._call("list", folder, lambda api, store: api.list(store, folder, offset=after, chunk_size=_BATCH))
        )
        while (batch := self._call("list", folder, lambda _api, _store: next(batches, None))) is not None:
            yield from (Listed(entry["path"], entry["size"]) for entry in batch)

    def list_folder(self, folder: str) -> tuple[list[str], list[Listed]]:
        """Returns the keys of the folders directly in a folder, and the objects directly in it."""
        listing = self._call("list", folder, lambda api, store: api.list_with_delimiter(store, folder or None))
        return list(listing["common_prefixes"]), [Listed(item["path"], item["size"]) for item in listing["objects"]]

    def copy(self, key: str, to: str) -> None:
        self._call("copy", key, lambda api, store: api.copy(store, key, to))

    def delete(self, *keys: str) -> None:
        """Deletes objects, if they exist."""
        for start in range(0, len(keys), _BATCH):
            self._delete(keys[start : start + _BATCH])

    def _delete(self, keys: Sequence[str]) -> None:
        paths = keys[0] if len(keys) == 1 else list(keys)
        with contextlib.suppress(FileNotFoundError):
            self._call("delete", keys[0], lambda api, store: api.delete(store, paths))

    def _call(self, what: str, key: str, action: Callable[[Any, Any], Any]) -> Any:
        import obstore
        from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError

        _require_own_process(self.url)
        place = f"{self.url}/{key}"
        try:
            return action(obstore, self._store)
        except (AlreadyExistsError, PreconditionError):
            raise FileExistsError(errno.EEXIST, "already exists", place) from None
        # errors of obstore may quote requests with their signatures, so they are not chained
        except FileNotFoundError as error:
            if "NoSuchBucket" not in str(error):
                raise FileNotFoundError(errno.ENOENT, "no such object", place) from None
            raise _world_error(what, place, str(error)) from None
        except BaseError as error:
            raise _world_error(what, place, str(error)) from None

    def __reduce__(self) -> tuple[Callable[[str], Objects], tuple[str]]:
        return objects_at, (self.url,)


_users: list[int] = []
"""Id of the first process that used a store."""


def _require_own_process(url: str) -> None:
    """Rejects requests in a forked process: it lacks the threads that send requests, and would wait forever."""
    if not _users:
        _users.append(os.getpid())
    if os.getpid() not in _users:
        raise UsageError(
            f"{url} cannot be read after a fork of a process that has read it: start processes with the method spawn, "
            "e.g. DataLoader(..., multiprocessing_context='spawn')"
        )


def _checked(url: str) -> str:
    scheme, _, rest = url.rstrip("/").partition("://")
    if scheme not in SCHEMES or not rest or any(mark in rest for mark in "?#") or ".." in rest.split("/"):
        raise UsageError(
            f"{_shown(url)!r} is not a valid location of a dataset: give a directory, "
            f"or {'://, '.join(SCHEMES)}://BUCKET/NAME"
        )
    if "@" in rest:
        raise UsageError(f"{_shown(url)!r}: a URL must not contain credentials; they are read from the environment")
    return f"{scheme}://{rest}"


def _shown(url: str) -> str:
    """Returns a URL without user information and query, which may contain a password or a signature."""
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
        text = str(error).split("\n")[0]
        raise UsageError(f"cannot open {url}: {text}; set the environment variables of your cloud provider") from None


def _world_error(what: str, place: str, text: str) -> WorldError:
    cause = _cause_of(text)
    remedy = next((remedy for mark, remedy in _REMEDIES if mark in cause), "check the store, then try again")
    return WorldError(f"cannot {what} {place}: {cause}; {remedy}")


def _cause_of(text: str) -> str:
    """Returns the cause of an error with the server's status code; the rest of its answer may contain secrets."""
    if any(path in text for path in _METADATA_SERVICES):
        return "no credentials were found"
    status, code = _STATUS.search(text), _CODE.search(text)
    if status is not None:
        return f"the store answers {status[1].strip()}{f' ({code[1]})' if code is not None else ''}"
    if "HTTP error" in text or "error sending request" in text:
        return "the store cannot be reached"
    return text.split(" error: ", 1)[0].split("\n")[0]
