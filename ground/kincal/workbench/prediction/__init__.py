"""Errors on poses that were not fitted, before and after effects; poses to measure next."""
