"""KinCal against other software that does the same, measured side by side: parts of `make bench`."""
