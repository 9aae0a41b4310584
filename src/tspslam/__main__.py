"""``python -m tspslam`` and ``tspslam``: the command line, whose loading can be interrupted too."""

import os


def main() -> None:
    """Load and run the command line."""
    try:
        from .cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        os.write(2, b"tspslam: interrupted\n")
        os._exit(130)


if __name__ == "__main__":
    main()
