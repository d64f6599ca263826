"""Errors of processes that share work."""

from __future__ import annotations


class FarmFailed(RuntimeError):
    """Raised where work of other processes has failed; the text is for the user."""


class WorkerDied(RuntimeError):
    """Raised where the process of a unit has ended without an answer; another one may make the unit."""
