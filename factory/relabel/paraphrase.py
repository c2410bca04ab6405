"""Asks an OpenAI-compatible endpoint for paraphrases of sentence patterns, and keeps those that pass a check.

Answers are kept in a cache file, so each pattern is sent only once. Writes no instruction.
"""

from __future__ import annotations

import hashlib
import http.client
import json
import os
import time
import urllib.error
import urllib.request
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from urllib.parse import urlsplit

from pydantic import Field, ValidationError

from schemas.base import Line, Model, Sha256
from schemas.errors import UsageError, WorldError
from schemas.language.language_file import LanguageSpec
from schemas.language.sentence.grammar import Grammar, grammar
from schemas.language.sentence.paraphrase import pattern_fault, plain_patterns
from schemas.storage.disk import replacing

KEY_VARIABLE = "MINIVLA_PARAPHRASE_KEY"
"""Environment variable of the API key, which is sent to the endpoint only."""
_MOST_BYTES = 1 << 20
_MOST_FAILURES = 3
"""Number of consecutive failed requests after which no further requests are sent."""
_WANTED = 3
_PROMPT = (
    "Rewrite this instruction for a mobile robot in {language} in {count} other ways, one on each line, without "
    "numbering. Keep its meaning and its register ({register}). Copy the placeholder {slot} exactly once into each "
    "line, and add no object, colour, place, number or negation.\n{text}"
)


class Endpoint(NamedTuple):
    """OpenAI-compatible endpoint."""

    url: str
    """Base URL, such as `http://localhost:8000/v1`."""
    model: str
    """Name of the model."""
    timeout_s: float = 60.0
    """Largest duration of a request, seconds."""


class ParaphraseCache(Model):
    """Content of a cache file: lines that an endpoint returned, by the digest of model and prompt."""

    answers: dict[Sha256, Annotated[tuple[Line, ...], Field(max_length=64)]] = Field(default_factory=dict)
    """Lines of each answer."""


class ParaphraseReport(Model):
    """Result of asking for paraphrases."""

    accepted: int
    """Number of new sentence patterns."""
    refused: dict[str, int]
    """Number of unusable lines, by reason."""
    failed: dict[str, int]
    """Number of patterns without an answer, by reason."""


class _Failed(Exception):
    """The endpoint gave no answer."""


class _Question(NamedTuple):
    """Prompt that requests paraphrases of one sentence pattern."""

    code: str
    register: str
    pattern: str
    prompt: str


def with_paraphrases(spec: LanguageSpec, endpoint: Endpoint, cache: Path) -> tuple[LanguageSpec, ParaphraseReport]:
    """Returns the language file with paraphrased sentence patterns, and a report of refused lines and failed requests.

    A pattern for which the endpoint gives no answer gets no paraphrases.

    Args:
        spec: content of the language file.
        endpoint: endpoint and model.
        cache: file of the answers; it is created if it does not exist.

    Raises:
        UsageError: the URL is not an HTTP URL.
        WorldError: the cache is damaged or cannot be written.
    """
    _require_url(endpoint.url)
    known, refused, failed = dict(_read(cache)), Counter[str](), Counter[str]()
    accepted: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    in_succession = 0
    # patterns, not sentences: in a sentence, the endpoint could change the referring expression, which could not be
    # verified then
    for request in _questions(spec):
        key = hashlib.sha256(f"{endpoint.model}\n{request.prompt}".encode()).hexdigest()
        if key not in known:
            if in_succession >= _MOST_FAILURES:
                failed["not asked, because the endpoint does not answer"] += 1
                continue
            try:
                known[key] = _ask(endpoint, request.prompt)
            except _Failed as error:
                failed[str(error)] += 1
                in_succession += 1
                continue
            in_succession = 0
            _write(cache, known)
        phrases = accepted[request.code][request.register]
        _keep(grammar(request.code), known[key], phrases, refused)
    kept = {
        code: {name: tuple(phrases) for name, phrases in group.items() if phrases} for code, group in accepted.items()
    }
    groups = {code: group for code, group in kept.items() if group}
    count = sum(len(phrases) for group in groups.values() for phrases in group.values())
    report = ParaphraseReport(accepted=count, refused=dict(refused), failed=dict(failed))
    return LanguageSpec.model_validate({**spec.model_dump(), "paraphrases": groups}), report


def _questions(spec: LanguageSpec) -> Iterator[_Question]:
    for code, share in spec.languages.items():
        source = grammar(code)
        for register in (name for name in source.patterns if share > 0 and spec.registers.get(name, 0.0) > 0):
            for text in plain_patterns(source, register):
                slot = text[text.index("{") : text.index("}") + 1]
                prompt = _PROMPT.format(language=source.name, count=_WANTED, register=register, slot=slot, text=text)
                yield _Question(code, register, text, prompt)


def _keep(source: Grammar, lines: tuple[str, ...], phrases: list[str], refused: Counter[str]) -> None:
    """Adds the usable lines to the patterns of a register, and counts the unusable lines by reason."""
    existing = {each.before + each.after for each in source.sentences}
    for line in lines:
        fault = pattern_fault(source.code, line)
        if fault:
            refused[fault] += 1
        elif line in phrases or line.replace("{np}", "") in existing:
            refused["the pattern exists already"] += 1
        else:
            phrases.append(line)


def _ask(endpoint: Endpoint, prompt: str) -> tuple[str, ...]:
    """Returns the lines of an answer.

    Raises:
        _Failed: no valid answer within the timeout.
    """
    body = {"model": endpoint.model, "messages": [{"role": "user", "content": prompt}], "temperature": 1.0, "seed": 0}
    headers = {"Content-Type": "application/json"}
    if os.environ.get(KEY_VARIABLE):
        headers["Authorization"] = f"Bearer {os.environ[KEY_VARIABLE]}"
    url = endpoint.url.rstrip("/") + "/chat/completions"
    request = urllib.request.Request(url, json.dumps(body).encode(), headers)  # noqa: S310 - see `_require_url`
    try:
        with _OPENER.open(request, timeout=endpoint.timeout_s) as reply:
            reply_text = json.loads(_within(reply, endpoint.timeout_s))["choices"][0]["message"]["content"]
        lines = tuple(filter(None, (line.strip(" \t-\u2022") for line in reply_text.splitlines())))
        return ParaphraseCache(answers={"0" * 64: lines}).answers["0" * 64]
    except urllib.error.HTTPError as error:
        raise _Failed(f"HTTP {error.code}") from error
    except TimeoutError as error:
        raise _Failed("timeout") from error
    except (OSError, http.client.HTTPException) as error:
        is_late = isinstance(getattr(error, "reason", None), TimeoutError)
        raise _Failed("timeout" if is_late else "not reachable") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise _Failed("invalid answer") from error


def _within(reply: http.client.HTTPResponse, timeout_s: float) -> bytes:
    """Returns the body of a reply; raises `TimeoutError` if reading it takes longer than the timeout."""
    until, parts = time.monotonic() + timeout_s, bytearray()
    while part := reply.read1(1 << 16):
        parts += part
        if time.monotonic() > until:
            raise TimeoutError
        if len(parts) > _MOST_BYTES:
            raise ValueError("the answer is larger than 1 MiB")
    return bytes(parts)


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Refuses redirections, which would send the key to another host."""

    def redirect_request(self, *_: Any, **__: Any) -> None:
        """Returns `None`, so the redirection becomes an `HTTPError`."""


_OPENER = urllib.request.build_opener(_NoRedirects)


def _require_url(url: str) -> None:
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise UsageError(f"--paraphrase {url[:80]!r} is not the URL of an endpoint, such as http://localhost:8000/v1")
    if parts.username or parts.password:
        raise UsageError(f"--paraphrase: remove the password from the URL; the key is read from {KEY_VARIABLE}")


def _read(cache: Path) -> Mapping[str, tuple[str, ...]]:
    if not cache.exists():
        return {}
    try:
        return ParaphraseCache.model_validate_json(cache.read_bytes()).answers
    except (OSError, ValidationError) as error:
        raise WorldError(f"{cache} is damaged: delete it, or choose another --paraphrase-cache") from error


def _write(cache: Path, known: dict[str, tuple[str, ...]]) -> None:
    with replacing(cache, durable=True) as part:
        part.write_text(ParaphraseCache(answers=known).model_dump_json(indent=1) + "\n", encoding="utf-8")
