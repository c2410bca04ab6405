"""Tests paraphrases by a loopback endpoint: usable patterns are kept, and everything else is counted and not added."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from factory.relabel.paraphrase import KEY_VARIABLE, Endpoint, with_paraphrases
from schemas.errors import InvalidLanguage, UsageError, WorldError
from schemas.language.compose import Composer
from schemas.language.language_file import LanguageSpec, load_language
from schemas.language.sentence.grammar import LANGUAGES, grammar
from schemas.language.sentence.paraphrase import pattern_fault, plain_patterns
from tests.builders.language import number_at, two_rooms, views

SPEC = LanguageSpec(registers={"terse": 1.0})
ASKED = len(plain_patterns(grammar("en"), "terse"))
KEY = "secret-key-of-the-test"


@contextmanager
def endpoint(reply: Callable[[BaseHTTPRequestHandler, str], None]) -> Iterator[tuple[str, list[dict[str, str]]]]:
    """Serves an endpoint on loopback; yields its URL and the headers of its requests."""
    seen: list[dict[str, str]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            seen.append(dict(self.headers) | {"path": self.path, "model": body["model"]})
            reply(self, body["messages"][0]["content"])

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/v1", seen
        finally:
            server.shutdown()
            thread.join()


def send(handler: BaseHTTPRequestHandler, body: bytes, status: int = 200) -> None:
    handler.send_response(status)
    handler.send_header("Content-Length", str(len(body)))
    handler.end_headers()
    handler.wfile.write(body)


def saying(*lines: str) -> Callable[[BaseHTTPRequestHandler, str], None]:
    body = json.dumps({"choices": [{"message": {"content": "\n".join(lines)}}]}).encode()
    return lambda handler, _: send(handler, body)


def test_usable_patterns_are_kept_written_and_read_back(tmp_path, monkeypatch):
    monkeypatch.setenv(KEY_VARIABLE, KEY)
    with endpoint(saying("- Advance until you get to {np}.", "Do not go to {np}.", "Go to the chair.")) as (url, seen):
        spec, report = with_paraphrases(SPEC, Endpoint(url, "small"), tmp_path / "cache.json")
        again = with_paraphrases(SPEC, Endpoint(url, "small"), tmp_path / "cache.json")
    assert spec.paraphrases == {"en": {"terse": ("Advance until you get to {np}.",)}}
    assert again[0] == spec
    assert len(seen) == ASKED, "cached answers are not requested again"
    assert {(each["path"], each["model"]) for each in seen} == {("/v1/chat/completions", "small")}
    assert {each["Authorization"] for each in seen} == {f"Bearer {KEY}"}
    assert KEY not in (tmp_path / "cache.json").read_text() + report.model_dump_json() + spec.model_dump_json()
    assert report.refused["it has a negation"] == report.refused["it does not have exactly one slot {np}"] == ASKED
    composer, scene = Composer(spec), two_rooms()
    said = [
        one
        for seed, view in enumerate(views(120))
        for one in composer.write(scene, view, number_at(-3.0, 1.6), False, np.random.default_rng(seed))
    ]
    own = [one for one in said if one.template_id == "en_paraphrase_terse_001"]
    assert own
    assert all(one.text.startswith("Advance until you get to the") for one in own)


@pytest.mark.parametrize(
    ("reply", "reason"),
    [
        (lambda handler, _: send(handler, b"oops", 500), "HTTP 500"),
        (lambda handler, _: send(handler, b"", 302), "HTTP 302"),
        (lambda handler, _: send(handler, b"<html>"), "invalid answer"),
        (lambda handler, _: send(handler, b'{"choices": []}'), "invalid answer"),
        (lambda handler, _: send(handler, b'{"choices": [{"message": {"content": 7}}]}'), "invalid answer"),
        (lambda handler, _: send(handler, b"[" * 100_000), "invalid answer"),
        (lambda handler, _: send(handler, b" " * (2 << 20)), "invalid answer"),
        (lambda handler, _: handler.connection.close(), "not reachable"),
    ],
)
def test_an_endpoint_that_answers_nonsense_adds_nothing_and_is_counted(tmp_path, reply, reason):
    with endpoint(reply) as (url, seen):
        spec, report = with_paraphrases(SPEC, Endpoint(url, "small"), tmp_path / "cache.json")
    assert spec == SPEC
    assert report.failed == {reason: 3, "not asked, because the endpoint does not answer": ASKED - 3}
    assert len(seen) == 3


def test_an_endpoint_that_is_down_or_slow_adds_nothing_and_is_counted(tmp_path):
    with endpoint(saying("x")) as (url, _):
        pass
    spec, report = with_paraphrases(SPEC, Endpoint(url, "small"), tmp_path / "cache.json")
    assert (spec, report.failed["not reachable"]) == (SPEC, 3)
    release = threading.Event()
    with endpoint(lambda handler, _: release.wait()) as (url, _):
        _, report = with_paraphrases(SPEC, Endpoint(url, "small", 0.05), tmp_path / "cache.json")
        release.set()
    assert report.failed["timeout"] == 3
    assert not (tmp_path / "cache.json").exists()


def test_foreign_urls_and_a_damaged_cache_are_refused(tmp_path):
    for url in ("file:///etc/passwd", "localhost:8000", "http://"):
        with pytest.raises(UsageError, match="is not the URL of an endpoint"):
            with_paraphrases(SPEC, Endpoint(url, "small"), tmp_path / "cache.json")
    with pytest.raises(UsageError, match="remove the password"):
        with_paraphrases(SPEC, Endpoint("http://a:b@localhost/v1", "small"), tmp_path / "cache.json")
    (tmp_path / "cache.json").write_text("{")
    with pytest.raises(WorldError, match="is damaged: delete it"):
        with_paraphrases(SPEC, Endpoint("http://localhost:1/v1", "small"), tmp_path / "cache.json")


@pytest.mark.parametrize(
    ("code", "text", "fault"),
    [
        ("en", "Would you kindly proceed to {np}?", ""),
        ("en", "The weather is nice near {np}.", "it names no action"),
        ("en", "Go to {np} behind the sofa.", "words that belong in the slot"),
        ("en", "Go to {np} and {np}.", "exactly one slot"),
        ("en", "Go to {0}.", "exactly one slot"),
        ("en", "Go to {np} (now|later).", "special characters"),
        ("en", "Go 3 metres to {np}.", "it has digits"),
        ("en", "Go to\u202e {np}.", "characters that are not text"),
        ("en", "Go to {np}." + " now" * 60, "too long"),
        ("de", "Fahr bitte sofort zu {np:dat}.", ""),
        ("de", "Fahr in Richtung {np:acc}.", "no built-in pattern has this word before a slot with this case"),
        ("de", "Fahr nicht zu {np:dat}.", "a negation"),
        ("es", "Avanza ahora mismo hasta {np}.", ""),
        ("es", "No vayas a {np}.", "a negation"),
        ("zh", "现在马上开到{np}。", ""),
        ("zh", "不要去{np}。", "a negation"),
    ],
)
def test_a_pattern_has_one_slot_and_an_action_and_nothing_else(code, text, fault):
    found = pattern_fault(code, text)
    assert fault in found if fault else found == ""


@pytest.mark.parametrize("code", LANGUAGES)
def test_built_in_patterns_with_an_action_pass_the_check(code):
    source = grammar(code)
    texts = [text for register in source.patterns for text in plain_patterns(source, register)]
    faults = [pattern_fault(code, text) for text in texts]
    assert set(faults) <= {"", "it names no action"}
    assert faults.count("") > len(faults) / 2


def test_patterns_of_a_language_file_are_checked(tmp_path):
    path = Path(tmp_path / "language.toml")
    path.write_text('[paraphrases.en]\npolite = ["Never go to {np}."]')
    with pytest.raises(InvalidLanguage, match=r"'Never go to .np..' is not a sentence pattern: it has a neg"):
        load_language(str(path))
    path.write_text('[paraphrases.en]\npoli = ["Go over to {np}."]')
    with pytest.raises(InvalidLanguage, match="unknown register 'poli'"):
        load_language(str(path))
