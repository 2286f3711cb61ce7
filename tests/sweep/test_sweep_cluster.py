"""A real dask cluster: scheduler and workers in own processes, in network namespaces where allowed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep.front import Progress, run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.prepare import prepare
from interarea.cosim.sweep.spec import load_sweep
from interarea.cosim.sweep.workers import dask_cluster as sweep_cluster
from interarea.cosim.sweep.workers.dask_cluster import cluster_outcomes

pytest.importorskip("distributed")
pytestmark = pytest.mark.timeout(280)


class Cluster:
    """Processes of a dask cluster; `prefix` runs them elsewhere (`ip netns exec NAME`)."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", port: int = 0) -> None:
        self.folder, self.host, self.port = folder, host, port
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler: subprocess.Popen[bytes] | None = None

    @property
    def address(self) -> str:
        return f"tcp://{self.host}:{self.port}"

    def start_scheduler(self, prefix: list[str] | None = None) -> None:
        file = self.folder / f"scheduler-{time.monotonic_ns()}.json"
        options = [
            "--host",
            self.host,
            "--port",
            str(self.port),
            "--no-dashboard",
            "--scheduler-file",
            str(file),
        ]
        self.scheduler = self._start(
            [*(prefix or []), sys.executable, "-m", "distributed.cli.dask_scheduler", *options]
        )
        end = time.monotonic() + 120.0
        while not file.exists() or not file.read_text().rstrip().endswith("}"):
            assert time.monotonic() < end and self.scheduler.poll() is None
            time.sleep(0.1)
        import json

        self.port = int(json.loads(file.read_text())["address"].rpartition(":")[2])

    def start_worker(self, prefix: list[str] | None = None, **environment: str) -> subprocess.Popen[bytes]:
        options = [
            "--nthreads",
            "1",
            "--no-dashboard",
            "--no-nanny",
            "--local-directory",
            str(self.folder / "dask"),
        ]
        command = [
            *(prefix or []),
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            self.address,
            *options,
        ]
        return self._start(command, **environment)

    def _start(self, command: list[str], **environment: str) -> subprocess.Popen[bytes]:
        log = (self.folder / "cluster.log").open("ab")
        # elsewhere than in a checkout, which would come before PYTHONPATH and what is installed
        started = subprocess.Popen(
            command, stdout=log, stderr=log, env={**os.environ, **environment}, cwd=self.folder
        )
        log.close()
        self.processes.append(started)
        return started

    def close(self) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.close()


def _outcomes(document: Any, cache: Path, address: str, **options: Any) -> Iterator[list[Any]]:
    plan = plan_sweep(load_sweep(document()), cache)
    return cluster_outcomes(
        plan, range(plan.sweep.size), cache=cache, files=prepare(plan, cache), address=address, **options
    )


def test_a_scheduler_that_cannot_be_reached_is_one_line(
    document: Any, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_cluster, "_CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:1", "nonsense://x", "tcp://"):
        with pytest.raises(SweepError, match="cannot be reached") as caught:
            next(_outcomes(document, cache, address))
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_rows_are_those_of_local_processes_though_a_worker_dies(
    document: Any, finished: Any, cache: Path, cluster: Cluster, tmp_path: Path
) -> None:
    cluster.start_scheduler()
    workers = [cluster.start_worker() for _ in range(2)]
    killed = False

    def kill_one(_: Progress) -> None:
        nonlocal killed
        if not killed:
            workers[0].kill()
            killed = True

    run_sweep(document(), tmp_path / "out", scheduler=cluster.address, cache=cache, progress=kill_one)
    pd.testing.assert_frame_equal(read_rows(tmp_path / "out"), finished[1], check_exact=True)


@pytest.mark.slow
@pytest.mark.parametrize("by_itself", [False, True])
def test_a_scheduler_that_is_restarted_loses_nothing(
    document: Any,
    finished: Any,
    cache: Path,
    cluster: Cluster,
    monkeypatch: pytest.MonkeyPatch,
    by_itself: bool,
) -> None:
    """Also when dask found the new scheduler by itself before the sweep looked: its files are gone then."""
    clients: list[Any] = []
    connect = sweep_cluster._Cluster.connect

    def watched(self: Any, timeout_s: float, workers_s: float) -> None:
        connect(self, timeout_s, workers_s)
        clients.append(self.client)

    monkeypatch.setattr(sweep_cluster._Cluster, "connect", watched)
    cluster.start_scheduler()
    cluster.start_worker()
    rows: dict[int, Any] = {}
    restarted = False
    for batch in _outcomes(document, cache, cluster.address, task=2, patience_s=120.0):
        for outcome in batch:
            assert outcome.row["run"] not in rows
            rows[outcome.row["run"]] = outcome.row
        if rows and not restarted:
            restarted = True
            _restart(cluster)
            if by_itself:
                _wait_until(lambda: clients[0].status in ("running", "closed"))
    assert restarted
    assert [rows[k]["energy_pu2s"] for k in range(12)] == list(finished[1].energy_pu2s)


def _restart(cluster: Cluster) -> None:
    assert cluster.scheduler is not None
    cluster.scheduler.kill()
    cluster.scheduler.wait()
    cluster.start_scheduler()
    cluster.start_worker()


def _wait_until(reached: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not reached() and time.monotonic() < end:
        time.sleep(0.05)
    assert reached()


@pytest.mark.slow
def test_a_worker_of_another_version_is_refused(
    document: Any, cache: Path, cluster: Cluster, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    front = Path(sys.modules["interarea"].__file__ or "").parent
    shutil.copytree(front, other / "interarea", ignore=shutil.ignore_patterns("__pycache__"))
    for room in ("models", "fmu_build", "design", "cosim"):
        source = Path(sys.modules[f"interarea.{room}"].__path__[0])
        shutil.copytree(source, other / "interarea" / room, ignore=shutil.ignore_patterns("__pycache__"))
    changed = other / "interarea" / "cosim" / "results" / "metrics.py"
    changed.write_text(changed.read_text() + "\n# another version\n")
    cluster.start_scheduler()
    cluster.start_worker(PYTHONPATH=str(other))
    with pytest.raises(
        SweepError, match=r"worker tcp://.*has another version of interarea .* install the same there"
    ):
        next(_outcomes(document, cache, cluster.address))


@pytest.mark.slow
def test_a_scheduler_without_workers_is_one_line(
    document: Any, cache: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_cluster, "_WORKERS_S", 0.5)
    cluster.start_scheduler()
    with pytest.raises(SweepError, match=r"has no workers after 0.5 s; start some with `dask worker tcp://"):
        next(_outcomes(document, cache, cluster.address))


# -- two hosts ----------------------------------------------------------------------------


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@pytest.fixture
def two_hosts() -> Iterator[list[str]]:
    """Return the names of two network namespaces on one bridge: hosts 10.213.7.2 and .3, this one .1."""
    names = [f"interarea-{os.getpid()}-{k}" for k in (1, 2)]
    bridge = f"ia{os.getpid() % 100000}"
    try:
        _ip("link", "add", bridge, "type", "bridge")
        _ip("addr", "add", "10.213.7.1/24", "dev", bridge)
        _ip("link", "set", bridge, "up")
        for k, name in enumerate(names, start=2):
            _ip("netns", "add", name)
            _ip("link", "add", f"{bridge}h{k}", "type", "veth", "peer", "name", "eth0", "netns", name)
            _ip("link", "set", f"{bridge}h{k}", "master", bridge, "up")
            _ip("-n", name, "addr", "add", f"10.213.7.{k}/24", "dev", "eth0")
            _ip("-n", name, "link", "set", "eth0", "up")
            _ip("-n", name, "link", "set", "lo", "up")
        yield [*names, bridge]
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespaces here: {error}")
    finally:
        for words in (*(("netns", "del", n) for n in names), ("link", "del", bridge)):
            subprocess.run(["ip", *words], check=False, capture_output=True)


@pytest.mark.slow
def test_two_hosts_one_of_which_is_cut_off(
    document: Any, finished: Any, cache: Path, two_hosts: list[str], tmp_path: Path
) -> None:
    one, two, bridge = two_hosts
    cluster = Cluster(tmp_path, host="10.213.7.1")
    try:
        timeouts = {
            "DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": "15s",
            "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "15s",
        }
        for key, value in timeouts.items():
            os.environ[key] = value
        cluster.start_scheduler()
        for name in (one, two):
            cluster.start_worker(["ip", "netns", "exec", name])
        rows: dict[int, Any] = {}
        cut = False
        for batch in _outcomes(document, cache, cluster.address, task=1, patience_s=120.0):
            rows |= {o.row["run"]: o.row for o in batch}
            if rows and not cut:
                _ip("link", "set", f"{bridge}h3", "down")
                cut = True
        assert cut
        assert [rows[k]["energy_pu2s"] for k in range(12)] == list(finished[1].energy_pu2s)
    finally:
        for key in timeouts:
            os.environ.pop(key, None)
        cluster.close()
