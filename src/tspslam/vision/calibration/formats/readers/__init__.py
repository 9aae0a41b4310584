"""Readers of calibration files, a program each: one function knows its files, one reads them."""
