"""`shift3d ui` as a real process: a single one, ended by any signal, and never on a port in use."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from shift3d.analysis.mlflow.client import share_view
from shift3d.analysis.mlflow.server import HOST, open_port
from shift3d.cli.main import main
from shift3d.errors import InputError

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# Children inherit ignored signals of the tests' own process, such as SIGHUP under nohup.
UI = ["env", "--default-signal=HUP,INT,TERM", sys.executable, "-m", "shift3d", "ui", "--port", "0"]
SIGNALS = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)  # SIGKILL: it is one process
Server = tuple[subprocess.Popen[str], str]


@pytest.fixture(scope="module")
def store(_empty: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Address of a store with one run, and the run; servers read it."""
    from mlflow import MlflowClient

    folder = tmp_path_factory.mktemp("store")
    uri = f"sqlite:///{shutil.copy(_empty, folder)}"
    client = MlflowClient(uri)
    experiment = client.create_experiment("shift3d", artifact_location=str(folder / "files"))
    run = client.create_run(experiment)
    client.log_text(run.info.run_id, "mode,auc\n", "auc.csv")
    client.log_metric(run.info.run_id, "shape/adversarial", 0.375)
    share_view(client, experiment, ["shape/adversarial"])
    return f"{uri} {run.info.run_id}"


@contextlib.contextmanager
def serving(folder: Path, store: str) -> Iterator[Server]:
    """Run a server in its own session until it answers. Yields (the process, its address)."""
    command = [*UI, "--uri", store.split()[0]]
    began = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert began.stdout
    (address,) = re.findall(rf"http://{HOST}:\d+", began.stdout.readline())
    assert urllib.request.urlopen(f"{address}/health", timeout=120).status == 200
    yield began, address
    for pid in session(began.pid):
        os.kill(pid, signal.SIGKILL)
    began.wait()
    began.stdout.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, store: str) -> Iterator[Server]:
    """A server that several tests read and none ends."""
    with serving(tmp_path_factory.mktemp("server"), store) as found:
        yield found


def session(pid: int) -> list[int]:
    """Return the processes of the session that ``pid`` leads, without zombies."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, leader = (entry / "stat").read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(leader) == pid and state != "Z":
            found.append(int(entry.name))
    return found


@pytest.mark.parametrize("number", SIGNALS, ids=lambda n: n.name)
def test_a_signal_ends_all_of_it(tmp_path: Path, store: str, number: signal.Signals) -> None:
    with serving(tmp_path, store) as (process, address):
        process.send_signal(number)
        process.wait(10)
        deadline = time.monotonic() + 5
        while left := session(process.pid):
            assert time.monotonic() < deadline, f"{len(left)} processes are left"
            time.sleep(0.1)
        with pytest.raises(urllib.error.URLError):
            urllib.request.urlopen(address, timeout=5)
    assert process.returncode == (0 if number == signal.SIGINT else -number)


def test_it_is_one_process_that_serves_the_page_and_files_of_runs(server: Server, store: str) -> None:
    process, address = server
    assert session(process.pid) == [process.pid]
    assert b"<html" in urllib.request.urlopen(address, timeout=30).read()
    file = f"{address}/get-artifact?run_uuid={store.split()[1]}&path=auc.csv"
    assert urllib.request.urlopen(file, timeout=30).read() == b"mode,auc\n"
    foreign = urllib.request.Request(f"{address}/ajax-api/2.0/mlflow/experiments/search", headers={"Host": "evil.org"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(foreign, timeout=30)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (Debian: apt install chromium)")
def test_the_list_of_runs_that_it_names_has_auc_columns(server: Server) -> None:
    process, address = server
    assert process.stdout
    (link,) = re.findall(r"http://\S+", process.stdout.readline())
    assert link.startswith(address)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1600, "height": 900})
        page.goto(link)
        page.get_by_text("shape/adversarial").first.wait_for(timeout=60_000)
        page.get_by_text("0.375").first.wait_for(timeout=60_000)
        browser.close()


def test_a_port_that_is_taken_is_said_and_not_announced(
    tmp_path: Path, store: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_port(0) as taken:
        port = taken.getsockname()[1]
        assert main(["ui", "--uri", store.split()[0], "--port", str(port)]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and f"port {port} cannot be opened (Address already in use)" in captured.err


def test_what_is_no_port_is_said_and_the_socket_is_on_loopback() -> None:
    with pytest.raises(InputError, match="99999"):
        open_port(99999)
    with open_port(0) as listening:
        assert listening.family == socket.AF_INET and listening.getsockname()[0] == "127.0.0.1"


def test_a_store_that_cannot_be_opened_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text.db").write_text("no database, but long enough to be read as one\n" * 100)
    assert main(["ui", "--uri", f"sqlite:///{tmp_path}/text.db", "--port", "0"]) == 2
    printed = capfd.readouterr().err
    assert "the store cannot be opened" in printed.splitlines()[-1] and "Traceback" not in printed
