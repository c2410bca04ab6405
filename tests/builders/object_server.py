"""Runs a real S3 server on loopback; its buckets are deleted at exit."""

from __future__ import annotations

import itertools
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ENVIRONMENT = ("AWS_ENDPOINT_URL", "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_REGION", "AWS_DEFAULT_REGION")
SECRET = "not-to-be-seen-in-any-message"
_numbers = itertools.count(1)


class ObjectServer:
    """A running S3 server, and a boto3 client with which tests access it directly."""

    def __init__(self, port: int) -> None:
        import boto3

        self.endpoint = f"http://127.0.0.1:{port}"
        self.client: Any = boto3.client(
            "s3",
            endpoint_url=self.endpoint,
            region_name="us-east-1",
            aws_access_key_id="tester",
            aws_secret_access_key=SECRET,
        )

    def variables(self) -> dict[str, str]:
        """Returns the environment variables for access to the server."""
        values = (self.endpoint, "tester", SECRET, "us-east-1", "us-east-1")
        return dict(zip(ENVIRONMENT, values, strict=True))

    def new_bucket(self) -> str:
        """Creates a bucket and returns its name."""
        name = f"bucket-{os.getpid()}-{next(_numbers)}"
        self.client.create_bucket(Bucket=name)
        return name

    def keys(self, bucket: str) -> list[str]:
        """Returns all keys of a bucket."""
        return [item["Key"] for item in self.client.list_objects_v2(Bucket=bucket).get("Contents", [])]


@contextmanager
def object_server() -> Iterator[ObjectServer]:
    """Runs a server until the end of the `with` block."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    try:
        yield ObjectServer(server.get_host_and_port()[1])
    finally:
        server.stop()
