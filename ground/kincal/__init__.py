"""KinCal on the ground: tables, search spaces, runs, logs, review and pictures.

Kinematics, terms, tables and events come from the flight core itself (kincal.flight), so what is
reviewed is what flies."""

__version__ = "0.1.0"
