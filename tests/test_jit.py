import collections
import hashlib
import json
import logging
import os
import subprocess
import sys

import pytest

from tests.sequences import SMALL_RIG, corridor, write_sequence
from tspslam import _jit, _kernel_cache
from tspslam.run import _compiling
from tspslam.run._compiling import LIST, listed

MODULE = """
from tspslam._jit import inlined, kernel
STEP = {step}
@inlined
def more(x):
    return x + {more}
@kernel
def one(x):
    '''{doc}'''
    return more(x) * STEP
"""
COUNT = (
    "from {name} import one; one(1); print(sum(one.stats.cache_hits.values()), sum(one.stats.cache_misses.values()))"
)
FOREIGN = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders of a user are closed to others there")


def one(x):
    return x + 1


def environment(cache):
    return os.environ | {"NUMBA_CACHE_DIR": str(cache)}


def start(code, cache, folder="."):
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment(cache), cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def outcome(process):
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out, err


def found(tmp_path, name="here", step=1, more=1, doc="One.", module="mine"):
    """Hits and misses of a process that calls a kernel of a module of that content."""
    folder = tmp_path / name
    folder.mkdir(exist_ok=True)
    (folder / f"{module}.py").write_text(MODULE.format(step=step, more=more, doc=doc))
    code = "import sys; sys.path.insert(0, '.'); sys.dont_write_bytecode = True; " + COUNT.format(name=module)
    return outcome(start(code, tmp_path / "cache", folder))[0].split()


def test_without_a_folder_kernels_compile_and_one_line_says_so(monkeypatch, caplog):
    monkeypatch.setattr(_jit, "find_folder", lambda: None)
    monkeypatch.setattr(_jit, "_said", set())
    with caplog.at_level(logging.WARNING, "tspslam"):
        kernels = [_jit.kernel(one), _jit.kernel(one)]
    assert [kernel(1) for kernel in kernels] == [2, 2]
    assert [record.message for record in caplog.records] == [
        "kernels are compiled anew in each process: there is no folder of your own that can be written"
    ]
    assert not _jit.is_cached(kernels[0])


def test_a_fresh_folder_is_announced_and_then_used(tmp_path):
    say = "from tspslam.cli._shared import announce_compilation as say; say()"

    def said(code):
        return "compiling kernels" in outcome(start(code, tmp_path))[1]

    assert said(say)
    use = (
        "from tspslam.run._compiling import compile_one, listed; from tspslam.topology import _harmonics\n"
        "[compile_one(*row) for row in listed() if row[1] == 'filter_one_ring']"
    )
    assert not said(use)
    assert not said(say)


def test_a_kernel_is_found_by_what_it_is_made_of_wherever_it_lies(tmp_path):
    assert found(tmp_path) == ["0", "1"]
    assert found(tmp_path) == ["1", "0"]
    assert found(tmp_path, "elsewhere", doc="Said otherwise.") == ["1", "0"]
    assert found(tmp_path, step=2) == ["0", "1"]
    assert found(tmp_path, more=2) == ["0", "1"]


def test_a_kernel_of_a_version_with_other_files_is_compiled_again(tmp_path):
    found(tmp_path)
    assert found(tmp_path, "later", module="moved") == ["0", "1"]
    for path in (tmp_path / "cache").rglob("*.bin"):
        content = b"cgone_since\none\n."  # a pickle of what is in a module that is not there
        path.write_bytes(hashlib.sha256(content).digest() + content)
    assert found(tmp_path) == ["0", "1"]
    assert found(tmp_path) == ["1", "0"]


def test_a_torn_file_is_compiled_again(tmp_path):
    found(tmp_path)
    for path in (tmp_path / "cache").rglob("*.bin"):
        path.write_bytes(path.read_bytes()[:-1])
    assert found(tmp_path) == ["0", "1"]
    assert found(tmp_path) == ["1", "0"]


@FOREIGN
@pytest.mark.parametrize("mode", [0o720, 0o702])
def test_a_folder_that_others_can_write_is_not_trusted(tmp_path, monkeypatch, mode):
    monkeypatch.setattr(_kernel_cache, "_bases", lambda: [tmp_path])
    find = _kernel_cache.find_folder.__wrapped__
    assert find().is_relative_to(tmp_path)
    (tmp_path / _kernel_cache.FOLDER).chmod(mode)
    assert find() is None


@FOREIGN
def test_a_link_to_a_folder_is_not_trusted(tmp_path, monkeypatch):
    (tmp_path / "theirs").mkdir(mode=0o700)
    (tmp_path / _kernel_cache.FOLDER).symlink_to(tmp_path / "theirs")
    monkeypatch.setattr(_kernel_cache, "_bases", lambda: [tmp_path])
    assert _kernel_cache.find_folder.__wrapped__() is None


def test_of_processes_that_need_the_same_kernel_one_compiles_it(tmp_path):
    code = COUNT.format(name="tspslam.topology._stars").replace("one", "face_neighbours")
    code = code.replace("face_neighbours(1)", "import numpy; face_neighbours(3, numpy.array([[0, 1, 2]], numpy.int32))")
    counts = [outcome(each)[0].split() for each in [start(code, tmp_path) for _ in range(3)]]
    assert sorted(counts) == [["0", "1"], ["1", "0"], ["1", "0"]]


@FOREIGN
def test_a_lock_that_its_owner_has_just_removed_is_no_claim(tmp_path, monkeypatch):
    import fcntl

    path, lock = tmp_path / "one.bin", fcntl.flock

    def lock_late(descriptor, how):
        path.with_suffix(".lock").unlink()
        lock(descriptor, how)

    with monkeypatch.context() as patched:
        patched.setattr(fcntl, "flock", lock_late)
        assert _kernel_cache._claim(path) is None
    claim = _kernel_cache._claim(path)
    assert claim is not None
    assert _kernel_cache._claim(path) is None
    _kernel_cache._release(path, claim)


INTERRUPTED = """
import sys; sys.path.insert(0, ".")
from mine import one
from tspslam import _kernel_cache
class Interrupted:
    def compile(self, *_):
        raise KeyboardInterrupt
def sleep(_):
    raise AssertionError("it waits for itself")
before, one._compiler, _kernel_cache.time.sleep = one._compiler, Interrupted(), sleep
try:
    one(1)
except KeyboardInterrupt:
    one._compiler = before
print(one(1), len(one._cache._claims))
"""


def test_a_compilation_that_was_interrupted_keeps_nobody_of_its_process_waiting(tmp_path):
    (tmp_path / "mine.py").write_text(MODULE.format(step=5, more=1, doc="One."))
    assert outcome(start(INTERRUPTED, tmp_path / "cache", tmp_path))[0].split() == ["10", "0"]


def test_helpers_compile_ahead_and_end_with_the_block(tmp_path):
    code = (
        "import time\n"
        "from tspslam._threads import set_threads\n"
        "from tspslam._kernel_cache import find_folder\n"
        "from tspslam.run import _compiling\n"
        "started, begin = [], _compiling.subprocess.Popen\n"
        "def keep(*given, **options):\n"
        "    started.append(begin(*given, **options))\n"
        "    return started[-1]\n"
        "_compiling.subprocess.Popen = keep\n"
        "set_threads(2)\n"
        "with _compiling.compiling(is_sequence=True, has_frames=False):\n"
        "    while not list(find_folder().glob('*.bin')) and all(each.poll() is None for each in started):\n"
        "        time.sleep(0.05)\n"
        "print([each.returncode for each in started], bool(list(find_folder().glob('*.bin'))))\n"
    )
    assert outcome(start(code, tmp_path))[0] == "[0, 0] True\n"


def test_what_a_first_frame_needs_is_loaded_when_the_block_begins(tmp_path):
    chosen = [row for row in listed(is_first=True) if row[1] in ("prefix_sums", "pack")]
    (tmp_path / "list.txt").write_text("\n".join(map(" ".join, chosen)) + "\n\n" + " ".join(listed()[-1]) + "\n")
    code = (
        "from tspslam._threads import set_threads\n"
        "from tspslam.run import _compiling\n"
        "from tspslam.topology import _harmonics, _pixels\n"
        "from tspslam.vision.slam.least_squares import _block_cholesky\n"
        "from pathlib import Path\n"
        f"_compiling.LIST = Path({str(tmp_path / 'list.txt')!r})\n"
        "set_threads(2)\n"
        "with _compiling.compiling(is_sequence=True):\n"
        "    kernels = _pixels.prefix_sums, _harmonics.pack, _block_cholesky.solve_blocks\n"
        "    print([len(kernel.signatures) for kernel in kernels])\n"
    )
    assert len(chosen) == 2
    assert outcome(start(code, tmp_path))[0] == "[1, 1, 0]\n"


def test_a_helper_that_fails_is_told_of_in_one_line(tmp_path, caplog, monkeypatch):
    broken = [str(tmp_path / "without the package")]
    monkeypatch.setattr(_compiling.sys, "path", broken)
    with caplog.at_level(logging.WARNING, "tspslam"), _compiling._helper(True) as process:
        process.wait()
    assert [record.message for record in caplog.records] == [
        "a process that compiled kernels ahead ended with code 1: ModuleNotFoundError: No module named 'tspslam'"
    ]


def test_a_helper_that_is_done_before_the_block_ends_says_nothing(tmp_path, caplog, monkeypatch):
    row = next(" ".join(row) for row in listed() if row[1] == "make_keys")
    (tmp_path / "list.txt").write_text(f"{row}\n")
    call = f"c.LIST = c.Path({str(tmp_path / 'list.txt')!r}); c.compile_listed(True)"
    code = f"import sys; sys.path[:] = {sys.path!r}; from tspslam.run import _compiling as c; {call}"
    begin = subprocess.Popen
    monkeypatch.setattr(_compiling.subprocess, "Popen", lambda _, **given: begin([sys.executable, "-c", code], **given))
    with caplog.at_level(logging.WARNING, "tspslam"), _compiling._helper(True) as process:
        assert process.wait() == 0
    assert caplog.records == []


def test_what_a_helper_says_does_not_stop_it(monkeypatch):
    code, begin = "import sys; sys.stderr.write('x' * 1_000_000)", subprocess.Popen
    monkeypatch.setattr(_compiling.subprocess, "Popen", lambda _, **given: begin([sys.executable, "-c", code], **given))
    with _compiling._helper(True) as process:
        assert process.wait() == 0


def test_a_full_disk_under_the_cache_costs_only_time(tmp_path):
    script = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))\n"
        "from tspslam.topology.complex import build_complex\n"
        "print(build_complex([[0, 1, 2]], 3).euler)\n"
    )
    assert outcome(start(script, tmp_path))[0] == "1\n"


def test_a_run_calls_each_kernel_with_one_set_of_types_and_those_are_listed_a_first_frame_s_before_others(tmp_path):
    """A kernel, or types, that a run needs anew: a line more for `LIST`, if it must be; another one to compile."""
    write_sequence(tmp_path / "drive", corridor(1.2, SMALL_RIG))
    fill = "from tspslam.run import _compiling as c; c._end_with_input = list; c.compile_listed(True)"
    subprocess.run([sys.executable, "-c", fill], check=True)  # so that only what Python calls is loaded
    code = (
        "import json, sys\n"
        "from tspslam.run.pipeline import run_path\n"
        "def called():\n"
        "    found = []\n"
        "    for module in [each for name, each in sys.modules.items() if name.startswith('tspslam.')]:\n"
        "        for name, kernel in vars(module).items():\n"
        "            if hasattr(kernel, 'overloads') and kernel.py_func.__module__ == module.__name__:\n"
        "                found += [(module.__name__, name, len(kernel.overloads))] * bool(kernel.overloads)\n"
        "    return found\n"
        "first = []\n"
        "def note(frame):\n"
        "    if not first and frame.response is not None:\n"
        "        first.extend(called())\n"
        f"run_path({str(tmp_path / 'drive')!r}, {str(tmp_path / 'run')!r}, on_frame=note)\n"
        "print(json.dumps([first, called()]))\n"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    first, called = json.loads(process.stdout)
    expected = {
        (module, name): count for (module, name), count in collections.Counter(row[:2] for row in listed()).items()
    }
    more = {f"{module} {name}": count for module, name, count in called if count > expected.get((module, name), 0)}
    assert len(called) > 20
    assert not more, LIST
    assert {(module, name) for module, name, _ in first} == {row[:2] for row in listed(is_first=True)}


def test_what_draws_is_not_imported_before_the_first_frame():
    code = "import sys; from tspslam.run import _compiling, pipeline, viewing; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
