"""`python -m kincal.space`: a worker process of a search (workers.py), not for people."""

import sys

from .workers import serve

serve(sys.stdin.buffer, sys.stdout.buffer)
