"""A real S3 server, for the tests that also run in a bucket."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from bucket_server import ENVIRONMENT, bucket_server


@pytest.fixture(scope="session")
def server() -> Iterator[str]:
    with bucket_server() as endpoint:
        yield endpoint


@pytest.fixture
def endpoint(server: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """The server's address, set in this test's environment."""
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server}.items():
        monkeypatch.setenv(name, value)
    return server
