"""Measurements: what a set of poses holds, the files it is read from, directions that no file states."""
