"""Writers of calibration files, a program each; what a format cannot hold is refused."""
