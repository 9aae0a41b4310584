"""Workers: on loopback alone, out of ctrl-C's reach, within their memory; those of a cluster are looked over first."""

import os
import socket
import sys
import threading

import pytest

from tspslam import cli
from tspslam.errors import InputError
from tspslam.scale import cluster
from tspslam.scale.cluster import Workers, check_workers, local_workers, running_cluster, unseen_paths

pytest.importorskip("distributed", reason="Dask is in the extra scale")
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="a matter of POSIX")
MEMORY = 600_000_000  # bytes


@pytest.fixture(scope="module")
def client():
    with pytest.MonkeyPatch.context() as patch:
        for name in cluster._POOLS:
            patch.delenv(name, raising=False)
        patch.setenv("NUMBA_NUM_THREADS", "2")
        with local_workers(1, 3, MEMORY) as found:
            yield found


def test_all_listen_on_loopback_alone(client):
    import psutil

    me = psutil.Process()
    sockets = [each for process in (me, *me.children(recursive=True)) for each in process.net_connections()]
    listening = {each.laddr.ip for each in sockets if each.status == psutil.CONN_LISTEN}
    assert listening == {"127.0.0.1"}


def test_a_worker_has_one_thread_for_tasks_and_its_share_for_kernels(client):
    assert set(client.nthreads().values()) == {1}
    (found,) = client.run(lambda: {name: os.environ.get(name) for name in cluster._POOLS}).values()
    assert found == dict.fromkeys(cluster._POOLS, "3") | {"NUMBA_NUM_THREADS": "2"}  # what a user says counts


@POSIX
def test_interrupts_do_not_reach_a_worker_and_still_reach_us(client):
    import signal

    (blocked,) = client.run(lambda: list(signal.pthread_sigmask(signal.SIG_BLOCK, ()))).values()
    assert signal.SIGINT in blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_workers_that_fit_pass_and_a_path_that_one_does_not_see_is_named(client, tmp_path):
    check_workers(client, [str(tmp_path)])
    with pytest.raises(InputError, match=rf"worker tcp://127\.0\.0\.1:\d+ does not see {tmp_path}/gone"):
        check_workers(client, [str(tmp_path), str(tmp_path / "gone")])
    assert unseen_paths([str(tmp_path)]) == []


@pytest.mark.parametrize(("package", "version"), [("numpy", "1.0"), ("tspslam", None), ("python", "3.9.1")])
def test_workers_of_other_versions_are_named_with_both(client, package, version):
    found = client.get_versions(packages=[*cluster._SAME])
    (address,) = found["workers"]
    cluster._check_versions("here", found)
    found["workers"][address]["packages"][package] = version
    with pytest.raises(InputError) as error:
        cluster._check_versions("here", found)
    said = str(error.value)
    assert f"{address} has {package} {'3.9' if package == 'python' else version or 'missing'}" in said
    assert f"expected {package} {cluster._versions(found['client'])[package]} on each" in said
    assert said.count(" has ") == 1


def grow(place):
    """Take more memory than a worker has; note which process does."""
    with open(place, "ab", buffering=0) as handle:
        handle.write(f"{os.getpid()}\n".encode())
    held = [b"1" * (100 << 20) for _ in range(8)]
    threading.Event().wait(60)
    return len(held)


def test_a_worker_that_takes_too_much_memory_is_ended_and_begun_anew(client, tmp_path):
    """Last of those that share the worker."""
    place = tmp_path / "attempts"
    future = client.submit(grow, str(place), pure=False)
    while not place.exists() or len(place.read_text().split()) < 2:
        assert not future.done()
        threading.Event().wait(0.05)
    client.cancel([future], force=True)
    assert len(set(place.read_text().split())) == 2


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1", "tcp://127.0.0.1:99999", "a b:80"])
def test_what_is_no_address_is_refused_at_once(address):
    with pytest.raises(InputError, match="is no address of a scheduler"), running_cluster(address, []):
        pass


@pytest.mark.parametrize("is_listening", [False, True])
def test_where_no_scheduler_answers_one_line_says_it(monkeypatch, is_listening):
    """Nobody is there, or somebody who says nothing."""
    monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        if not is_listening:
            server.close()
        said = rf"^{address}: no scheduler answers within 0\.5 s"
        with pytest.raises(InputError, match=said), running_cluster(address, []):
            pass


@pytest.mark.parametrize("given", [{"count": 0}, {"threads": True}, {"memory": 10}, {"count": 2.0}])
def test_workers_that_cannot_be_are_refused(given):
    with pytest.raises(InputError, match=f"workers: {next(iter(given))} is"):
        Workers(**given)


def test_a_scheduler_goes_with_no_count():
    with pytest.raises(InputError, match="has workers of its own"):
        Workers(scheduler="tcp://127.0.0.1:8786", count=2)


def test_without_dask_one_line_says_how_to_install_it(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert cli.exit_code(["batch", str(tmp_path), "--out", str(tmp_path / "runs")]) == cli.BAD_INPUT
    assert capsys.readouterr().err == (
        "tspslam: Dask is not installed, expected the extra scale: pip install 'tspslam[scale]'\n"
    )
    assert not (tmp_path / "runs").exists()
