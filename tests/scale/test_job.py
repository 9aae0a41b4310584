"""One recording on its worker: attempts are counted on disk, a batch that has ended takes its runs with it."""

import errno
import shutil
import threading

import pytest

from tspslam.io.lock import FolderLock
from tspslam.run.config import resolve
from tspslam.run.pipeline import run_path
from tspslam.scale import job as jobs
from tspslam.scale.job import MOST_ATTEMPTS, Job, run_job

from .recordings import content, write_walk


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walks") / "walk"
    write_walk(folder, 2.0)
    return folder


@pytest.fixture
def told(monkeypatch):
    """What a worker's client would hear; there is no worker here."""
    messages = []
    monkeypatch.setattr(jobs, "tell", lambda topic, values: messages.append((topic, values)))
    yield messages
    jobs.set_threads(None)


@pytest.fixture
def job(walk, tmp_path, told):
    (tmp_path / "ticket").mkdir()
    return Job("walk", str(walk), str(tmp_path / "runs" / "walk"), resolve(), str(tmp_path / "ticket"), 1, "topic")


def test_a_job_has_the_bytes_of_a_run_and_says_how_far_it_is(job, walk, told, tmp_path):
    assert run_job(job) == jobs.Outcome("run", attempts=1)
    run_path(walk, tmp_path / "alone")
    assert content(tmp_path / "runs" / "walk") == content(tmp_path / "alone")
    assert {topic for topic, _ in told} == {"topic"}
    assert [values["stage"] for _, values in told][-1] == "report"
    assert {values["name"] for _, values in told} == {"walk"}


def test_attempts_are_counted_and_the_third_is_not_begun(job, tmp_path):
    (tmp_path / "ticket" / "walk").write_bytes(b"." * MOST_ATTEMPTS)  # as left by workers that died
    outcome = run_job(job)
    assert (outcome.state, outcome.attempts) == ("poisoned", MOST_ATTEMPTS)
    assert "died 2 times" in outcome.error
    assert not (tmp_path / "runs").exists()


def test_without_its_ticket_a_job_is_not_begun(job, tmp_path):
    shutil.rmtree(tmp_path / "ticket")
    assert run_job(job).state == "withdrawn"
    assert not (tmp_path / "runs").exists()


def test_a_run_ends_when_its_ticket_goes_and_is_gone_on_with(job, tmp_path, monkeypatch, told):
    whole = run_job(job)
    before = content(tmp_path / "runs" / "walk")
    shutil.rmtree(tmp_path / "runs" / "walk")

    def withdraw(topic, values):
        if values["stage"] == "map":
            shutil.rmtree(tmp_path / "ticket")

    monkeypatch.setattr(jobs, "_LOOK", -1.0)
    monkeypatch.setattr(jobs, "tell", withdraw)
    assert run_job(job).state == "withdrawn"
    assert not (tmp_path / "runs" / "walk" / "report.html").exists()
    (tmp_path / "ticket").mkdir()
    monkeypatch.setattr(jobs, "tell", lambda *_: None)
    again = run_job(job)
    assert (whole.is_resumed, again.state, again.is_resumed) == (False, "run", True)
    assert content(tmp_path / "runs" / "walk") == before


def test_a_folder_that_an_ending_run_holds_is_waited_for(job, tmp_path, monkeypatch):
    out = tmp_path / "runs" / "walk"
    out.mkdir(parents=True)
    lock, looks = FolderLock(out), []

    def pause(seconds):
        looks.append(seconds)
        lock.release()

    monkeypatch.setattr(jobs.time, "sleep", pause)
    assert run_job(job).state == "run"
    assert len(looks) == 1


def test_a_folder_that_somebody_else_holds_is_refused_after_a_while(job, tmp_path, monkeypatch):
    out = tmp_path / "runs" / "walk"
    out.mkdir(parents=True)
    lock = FolderLock(out)
    monkeypatch.setattr(jobs, "_PATIENCE", -1.0)
    outcome = run_job(job)
    lock.release()
    assert outcome.state == "refused"
    assert "is in use by" in outcome.error


def test_a_process_runs_one_at_a_time(job, told, tmp_path):
    """Two runs would share a budget of threads and memory that is meant for one."""
    both = [Job(**(vars(job) | {"name": name, "out": str(tmp_path / name)})) for name in ("a", "b")]
    threads = [threading.Thread(target=run_job, args=(each,)) for each in both]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    names = [values["name"] for _, values in told]
    assert len(set(names)) == 2
    assert len([k for k in range(1, len(names)) if names[k] != names[k - 1]]) == 1


def test_what_goes_wrong_is_an_outcome(job, tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    bad = Job(**(vars(job) | {"source": str(tmp_path / "gone")}))
    assert run_job(bad).state == "refused"
    (tmp_path / "runs").write_text("in the way")
    assert run_job(job).state == "not written"


def test_errors_of_ours_are_raised(job, monkeypatch):
    def fail(*_, **__):
        raise OSError("no such thing")

    monkeypatch.setattr(jobs, "run_path", fail)
    with pytest.raises(OSError, match="no such thing"):
        run_job(job)


def test_no_room_is_told_from_other_errors(job, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(jobs, "run_path", fail)
    assert run_job(job).state == "not written"
