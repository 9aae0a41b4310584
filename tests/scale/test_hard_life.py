"""A disk that is full, ctrl-C, kill -9 of all, a scheduler that dies: the same command ends with the same bytes."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from tspslam import cli
from tspslam.run.pipeline import run_path
from tspslam.scale.batch import run_batch
from tspslam.scale.cluster import Workers

from .recordings import content, write_walk

pytest.importorskip("distributed", reason="Dask is in the extra scale")
pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="groups of processes are a matter of POSIX")
NAMES = "first", "second"
NARROW = 50_000  # bytes: less than a frame, more than a summary and its page


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walks")
    for name in NAMES:
        write_walk(folder / name, 4.0)
    return folder


@pytest.fixture(scope="module")
def alone(walks, tmp_path_factory):
    """What single runs leave, with pictures as other processes draw them."""
    out = tmp_path_factory.mktemp("alone")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tspslam.view._style.DPI", 140)
        for name in NAMES:
            run_path(walks / name, out / name)
    return {name: content(out / name) for name in NAMES}


@contextlib.contextmanager
def begun(*words, narrow=False):
    """A command in a group of its own, as a terminal has it; perhaps where no file may be large."""

    def limit():
        import resource

        signal.signal(signal.SIGINT, signal.SIG_DFL)  # what a shell began behind itself does not hear ctrl-C
        if narrow:
            resource.setrlimit(resource.RLIMIT_FSIZE, (NARROW, NARROW))

    words = [sys.executable, "-m", "tspslam", *map(str, words)]
    process = subprocess.Popen(words, stdout=-1, stderr=-1, text=True, start_new_session=True, preexec_fn=limit)
    with process:  # which closes its pipes
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def wait_for_frames(process):
    """Wait until a recording has frames behind it."""
    for line in process.stderr:
        if any(each["done"] or each["stage"] != "tracking" for each in json.loads(line).get("running", [])):
            return
    raise AssertionError("the batch has ended before")


def is_group_gone(process):
    for _ in range(300):
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_after_every_mishap_the_same_command_goes_on_and_ends_with_the_same_bytes(walks, alone, tmp_path):
    words = ["batch", walks, "--out", tmp_path / "runs", "--workers", 2, "--threads", 2, "--json"]

    with begun(*words, narrow=True) as full:
        out, _ = full.communicate()
    assert full.returncode == cli.NOT_WRITTEN
    told = json.loads(out)
    assert told["states"] == {"not written": 2}
    assert all("cannot be written" in row["error"] for row in told["rows"])

    with begun(*words) as interrupted:
        wait_for_frames(interrupted)
        os.killpg(interrupted.pid, signal.SIGINT)
        _, err = interrupted.communicate()
        assert is_group_gone(interrupted)
    assert interrupted.returncode == cli.INTERRUPTED
    assert err.splitlines()[-1] == "tspslam: interrupted; the same command goes on where this one stopped"
    assert "Traceback" not in err
    told = json.loads((tmp_path / "runs" / "batch.json").read_text())
    assert told["states"] == {"unfinished": 2}

    with begun(*words) as killed:
        wait_for_frames(killed)
        killed.kill()
        killed.wait()
        assert is_group_gone(killed)  # its workers end with it

    with begun(*words) as whole:
        out, _ = whole.communicate()
    assert whole.returncode == cli.COMPLETE
    assert json.loads(out)["states"] == {"complete": 2}
    assert {name: content(tmp_path / "runs" / name) for name in NAMES} == alone
    assert sorted(os.listdir(tmp_path / "runs")) == ["batch.html", "batch.json", *NAMES]


@contextlib.contextmanager
def cluster(folder):
    """A scheduler and a worker of it, each a process: the scheduler's process, and its address."""
    file, dask = folder / "scheduler.json", [sys.executable, "-m"]
    common = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    processes = [subprocess.Popen([*dask, "distributed.cli.dask_scheduler", *common, "--port", "0"], **quiet)]
    try:
        more = ["--nthreads", "1", "--no-nanny", "--death-timeout", "60"]
        processes += [subprocess.Popen([*dask, "distributed.cli.dask_worker", *common, *more], **quiet)]
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.1)
        yield processes[0], json.loads(file.read_text())["address"]
    finally:
        for process in processes:
            process.kill()
            process.wait()
        file.unlink(missing_ok=True)


def test_a_scheduler_that_dies_ends_the_batch_and_another_goes_on_with_it(walks, alone, tmp_path):
    with cluster(tmp_path) as (scheduler, address):
        result = run_batch(
            [walks], tmp_path / "runs", workers=Workers(scheduler=address),
            on_event=lambda event: scheduler.kill() if event.kind == "step" and event.values["done"] else None,
        )  # fmt: skip
    assert "does not answer any more" in result.lost
    assert {row.state for row in result.rows} == {"unfinished"}
    assert not (tmp_path / "runs" / ".batch").exists()
    with cluster(tmp_path) as (_, address):
        result = run_batch([walks], tmp_path / "runs", workers=Workers(scheduler=address))
    assert (result.lost, {row.state for row in result.rows}) == ("", {"complete"})
    assert {name: content(tmp_path / "runs" / name) for name in NAMES} == alone
