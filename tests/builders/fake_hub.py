"""A Hugging Face Hub on loopback that stores uploads in memory.

Implements the public HTTP interface (create, preupload, LFS batch, commit, tags) with one token; can fail on demand.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Self

TOKEN = "hf_" + "t" * 34
_LFS_FROM_BYTES = 2000
_REVISION = "0" * 40


@dataclass
class Repository:
    name: str
    private: bool
    files: dict[str, bytes] = field(default_factory=dict)
    commits: list[str] = field(default_factory=list)
    tags: dict[str, int] = field(default_factory=dict)
    """Tag -> number of commits that the repository had when the tag was created."""


class FakeHub:
    """A Hub with repositories and the objects of its large-file storage."""

    def __init__(self) -> None:
        self.repositories: dict[str, Repository] = {}
        self.objects: dict[str, bytes] = {}
        self.uploads: list[str] = []
        """Digests of the uploaded objects in order of arrival."""
        self.requests: list[str] = []
        self.fail_at_commit: int | None = None
        """Number of a commit that is refused once with status 400; `None` for no failure."""
        hub = self

        class Handler(_Handler):
            fake = hub

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    fake: FakeHub
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        self.fake.requests.append(format % args)

    def do_POST(self) -> None:
        body = self._body()
        if self.path.startswith("/lfs/verify"):
            return self._answer(200, {})
        if self.headers.get("Authorization") != f"Bearer {TOKEN}":
            return self._answer(401, {"error": "Invalid credentials"})
        path = self.path.partition("?")[0]
        if path == "/api/repos/create":
            return self._create(json.loads(body))
        if path == "/api/validate-yaml":
            return self._answer(200, {"errors": [], "warnings": []})
        found = re.fullmatch(r"/api/datasets/([^/]+/[^/]+)/(preupload|commit|tag)/main", path)
        if found:
            repository = self.fake.repositories[found[1]]
            return getattr(self, f"_{found[2]}")(repository, body)
        if path.endswith(".git/info/lfs/objects/batch"):
            return self._batch(json.loads(body))
        return self._answer(404, {"error": f"no {path}"})

    def do_PUT(self) -> None:
        data = self._body()
        name = self.path.rpartition("/")[2]
        digest = hashlib.sha256(data).hexdigest()
        if digest != name:
            return self._answer(400, {"error": "another digest"})
        self.fake.objects[name] = data
        self.fake.uploads.append(name)
        return self._answer(200, {})

    def do_DELETE(self) -> None:
        found = re.fullmatch(r"/api/datasets/([^/]+/[^/]+)/tag/(.+)", self.path)
        tags = self.fake.repositories[found[1]].tags if found else {}
        if not found or tags.pop(found[2], None) is None:
            return self._answer(404, {"error": "no such tag"}, {"X-Error-Code": "RevisionNotFound"})
        return self._answer(200, {})

    def do_GET(self) -> None:
        self._answer(404, {"error": f"no {self.path}"})

    def _create(self, wanted: dict[str, Any]) -> None:
        name = f"{wanted['organization']}/{wanted['name']}"
        if wanted["organization"] == "another-user":
            return self._answer(403, {"error": "You don't have the rights"})
        url = {"url": f"{self.fake.url}/datasets/{name}"}
        if name in self.fake.repositories:
            return self._answer(409, {"error": "exists", **url})
        private = wanted.get("visibility") == "private" or bool(wanted.get("private"))
        self.fake.repositories[name] = Repository(name, private)
        return self._answer(200, url)

    def _preupload(self, repository: Repository, body: bytes) -> None:
        del repository
        answers = [
            {
                "path": file["path"],
                "uploadMode": "lfs" if file["size"] >= _LFS_FROM_BYTES else "regular",
                "shouldIgnore": False,
                "oid": None,
            }
            for file in json.loads(body)["files"]
        ]
        self._answer(200, {"files": answers})

    def _batch(self, wanted: dict[str, Any]) -> None:
        answers = []
        for item in wanted["objects"]:
            entry: dict[str, Any] = {"oid": item["oid"], "size": item["size"]}
            if item["oid"] not in self.fake.objects:
                entry["actions"] = {"upload": {"href": f"{self.fake.url}/lfs/{item['oid']}"}}
            answers.append(entry)
        self._answer(200, {"transfer": "basic", "objects": answers})

    def _commit(self, repository: Repository, body: bytes) -> None:
        number = len(repository.commits) + 1
        if self.fake.fail_at_commit == number:
            self.fake.fail_at_commit = None
            return self._answer(400, {"error": "temporary disk error of the hub"})
        for line in body.splitlines():
            item = json.loads(line)
            value = item["value"]
            if item["key"] == "header":
                repository.commits.append(value["summary"])
            elif item["key"] == "file":
                repository.files[value["path"]] = base64.b64decode(value["content"])
            elif item["key"] == "lfsFile":
                repository.files[value["path"]] = self.fake.objects[value["oid"]]
        url = f"{self.fake.url}/datasets/{repository.name}/commit/{_REVISION}"
        return self._answer(200, {"success": True, "commitOid": _REVISION, "commitUrl": url})

    def _tag(self, repository: Repository, body: bytes) -> None:
        tag = json.loads(body)["tag"]
        if tag in repository.tags:
            return self._answer(409, {"error": "tag exists"})
        repository.tags[tag] = len(repository.commits)
        return self._answer(200, {})

    def _body(self) -> bytes:
        if self.headers.get("Transfer-Encoding") == "chunked":
            parts = []
            while size := int(self.rfile.readline(), 16):
                parts.append(self.rfile.read(size))
                self.rfile.readline()
            self.rfile.readline()
            return b"".join(parts)
        return self.rfile.read(int(self.headers.get("Content-Length", 0)))

    def _answer(self, status: int, content: dict[str, Any], headers: dict[str, str] | None = None) -> None:
        data = json.dumps(content).encode()
        self.send_response(status)
        for name, value in {"Content-Type": "application/json", **(headers or {})}.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)
