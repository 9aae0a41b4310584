import logging
import os
import subprocess
import sys

from tspslam import _jit


def one(x):
    return x + 1


def test_without_a_cache_folder_kernels_compile_and_one_line_says_so(monkeypatch, caplog):
    real = _jit.numba.njit

    def refusing(*args, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return real(*args, **options)

    monkeypatch.setattr(_jit.numba, "njit", refusing)
    monkeypatch.setattr(_jit, "_said", set())
    with caplog.at_level(logging.WARNING, "tspslam"):
        kernels = [_jit.kernel(one), _jit.kernel(one)]
    assert [kernel(1) for kernel in kernels] == [2, 2]
    assert [record.message for record in caplog.records] == [
        "kernels are compiled anew in each process: numba found no folder that it can write"
    ]
    assert not _jit.is_cached(kernels[0])


def test_a_fresh_cache_folder_is_announced_and_then_used(tmp_path, pair_files):
    script = "from tspslam.cli._shared import announce_compilation as say; say()"
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PATH": ""}

    def said(code):
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        return "compiling kernels" in done.stderr

    assert said(script)
    (tmp_path / "cache").mkdir(exist_ok=True)
    use = "from tspslam.topology._harmonics import pack; import numpy as n; pack(0, n.ones((1,2)), n.ones(1), n.ones(1, bool), n.ones((1,4)))"
    assert not said(use)
    assert not said(script)


def test_a_full_disk_under_the_cache_costs_only_time(tmp_path):
    script = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))\n"
        "from tspslam.topology.complex import build_complex\n"
        "print(build_complex([[0, 1, 2]], 3).euler)\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("1\n", 0), done.stderr
