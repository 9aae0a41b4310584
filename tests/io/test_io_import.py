import subprocess
import sys


def test_importing_io_loads_no_image_or_yaml_library():
    code = "import sys, tspslam.io; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"PIL", "yaml", "scipy", "numba", "cv2", "matplotlib"} & set(run.stdout.split())
