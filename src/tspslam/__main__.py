"""``python -m tspslam`` is the command line."""

from .cli import main

main()
