"""`python -m kincal.space`: a helper process of a search (work.py), not for people."""

from .work import helper

helper()
