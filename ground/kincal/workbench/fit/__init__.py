"""Fit of a model to measurements: least squares, design columns, what the poses determine."""
