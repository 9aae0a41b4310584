"""``tspslam view`` as a process of its own."""

import contextlib
import subprocess
import sys


@contextlib.contextmanager
def served(*arguments):
    """``tspslam view`` as a process in a group of its own, and its address."""
    command = [sys.executable, "-m", "tspslam", "view", *map(str, arguments)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True) as process:
        lines = []
        try:
            for line in process.stderr:
                lines.append(line)
                if line.startswith("viewer: "):
                    break
            yield process, lines
        finally:
            if process.poll() is None:
                process.kill()
