"""Uploads to the Hugging Face Hub: creates the repository, commits files in batches, moves the tag.

`huggingface_hub` is imported here only. The module does not select files. It reads the token from `HF_TOKEN` or the
file that `hf auth login` writes, and never prints or logs it. The token is not accepted as a command line argument,
because other users of the machine can read these arguments.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from factory.push.files import PushPlan, batches_of
from schemas.errors import UsageError, WorldError
from schemas.support.extras import missing_package

ProgressCallback = Callable[[int, int], None]
"""Called with the number of files and bytes of each commit."""
_AGAIN = "run the same command again; files already on the Hub are not sent again"


class PushResult(NamedTuple):
    """Result of an upload."""

    url: str
    """URL of the repository."""
    commits: int
    """Number of commits sent; files that are already on the Hub add no content to them."""
    files: int
    total_bytes: int
    tag: str | None


def push(
    plan: PushPlan,
    repository: str,
    endpoint: str | None = None,
    private: bool = False,
    tell: ProgressCallback | None = None,
) -> PushResult:
    """Uploads a folder; after an interruption, the same call resumes, because the Hub skips files it already has.

    Args:
        plan: Upload plan.
        repository: OWNER/NAME of a dataset repository, created if it does not exist.
        endpoint: URL of the Hub; `None` means huggingface.co.
        private: Whether a new repository is private.
        tell: Progress callback, called after every commit.

    Raises:
        UsageError: The endpoint is not encrypted, or huggingface_hub is not installed.
        WorldError: The token is missing, has no write permission, or the connection failed.
    """
    hub = _library()
    token = hub.get_token()
    api = hub.HfApi(endpoint=endpoint, token=token, library_name="minivla-factory")
    require_safe_endpoint(api.endpoint)
    if not token:
        raise WorldError(
            "the token for the Hugging Face Hub is missing: run `hf auth login`, or set HF_TOKEN to a token with write "
            f"access (create one at {api.endpoint}/settings/tokens)"
        )
    with _translated(hub, repository, api.endpoint):
        url = api.create_repo(repository, repo_type="dataset", private=private or None, exist_ok=True)
        commits = _commit_all(hub, api, plan=plan, repository=repository, tell=tell)
        if plan.tag is not None:
            _move_tag(hub, api, repository, plan.tag)
    return PushResult(str(url), commits, files=len(plan.files), total_bytes=plan.total_bytes, tag=plan.tag)


def require_safe_endpoint(endpoint: str) -> None:
    """Raises an error unless the connection to the endpoint is encrypted or local.

    Raises:
        UsageError: The endpoint is neither an https URL nor on loopback.
    """
    parts = urlsplit(endpoint)
    if parts.scheme == "https" and parts.hostname:
        return
    if parts.scheme != "http" or not _is_loopback(parts.hostname or ""):
        raise UsageError(f"endpoint {endpoint!r} would send your token unencrypted: give an https:// URL")


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _library() -> ModuleType:
    try:
        import huggingface_hub
        from huggingface_hub.utils.tqdm import disable_progress_bars
    except ImportError as error:
        raise missing_package("huggingface_hub", "`factory push`") from error
    disable_progress_bars()  # `factory push` prints progress itself
    return huggingface_hub


def _commit_all(hub: ModuleType, api: Any, plan: PushPlan, repository: str, tell: ProgressCallback | None) -> int:
    batches = list(batches_of(plan.files))
    for number, batch in enumerate(batches, 1):
        added = [hub.CommitOperationAdd(path_in_repo=file.name, path_or_fileobj=str(file.path)) for file in batch]
        part = f" (part {number} of {len(batches)})" if len(batches) > 1 else ""
        api.create_commit(
            repository,
            added,
            commit_message=f"Upload {plan.kind} with minivla-factory{part}",
            repo_type="dataset",
        )
        if tell is not None:
            tell(len(batch), sum(file.size for file in batch))
    return len(batches)


def _move_tag(hub: ModuleType, api: Any, repository: str, tag: str) -> None:
    """Moves a tag to the latest commit. LeRobot reads the commit that is tagged with the version of its format."""
    try:
        api.delete_tag(repository, tag=tag, repo_type="dataset")
    except hub.errors.RevisionNotFoundError:
        pass
    except hub.errors.HfHubHTTPError as error:
        if error.response is None or error.response.status_code != 404:
            raise
    api.create_tag(repository, tag=tag, repo_type="dataset")


@contextmanager
def _translated(hub: ModuleType, repository: str, endpoint: str) -> Iterator[None]:
    try:
        yield
    except hub.errors.HfHubHTTPError as error:
        status = error.response.status_code if error.response is not None else None
        raise WorldError(
            _describe_status(status, repository, endpoint, error)
        ) from None  # the cause is omitted, because it contains the request with the token
    except hub.errors.HFValidationError as error:
        raise UsageError(f"{repository!r} is not a valid repository: {error}") from None
    except (hub.errors.HTTPError, OSError, ValueError, RuntimeError) as error:
        raise WorldError(f"the upload to {endpoint} stopped ({type(error).__name__}: {error}); {_AGAIN}") from None


def _describe_status(status: int | None, repository: str, endpoint: str, error: Exception) -> str:
    if status in (401, 403):
        return (
            f"{endpoint} rejected the token for {repository} ({status}): the token needs write access to that owner; "
            "log in again with `hf auth login` or set HF_TOKEN"
        )
    if status == 404:
        return f"{endpoint} did not find {repository}, or the token has no access to it (404): check owner and name"
    if status == 413 or status == 507:
        return f"{endpoint} has no storage left for {repository} ({status}): check its storage limits"
    first = str(error).strip().splitlines()
    return f"{endpoint} answered {status} ({first[0] if first else type(error).__name__}); {_AGAIN}"
