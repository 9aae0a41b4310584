import doctest
import importlib
import subprocess
import sys

import pytest

MODULES = ["atomic", "frames", "images", "lock", "manifest", "mesh", "ply", "runfolder", "trajectory", "vtu"]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_in_the_docstrings_run(name):
    found = doctest.testmod(importlib.import_module(f"tspslam.io.{name}"))
    assert found.attempted > 0
    assert found.failed == 0


def test_importing_io_loads_no_image_or_yaml_library():
    code = "import sys, tspslam.io; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"PIL", "yaml", "scipy", "numba", "cv2", "matplotlib"} & set(run.stdout.split())
