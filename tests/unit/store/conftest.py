"""A real S3 server, for the tests that take place in a bucket too."""

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
    """The server's address, which this test's environment names."""
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server}.items():
        monkeypatch.setenv(name, value)
    return server
