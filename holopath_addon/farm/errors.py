"""What goes wrong between processes that share work."""

from __future__ import annotations


class FarmFailed(RuntimeError):
    """Work that others did has failed; the text is one sentence for the user."""


class WorkerDied(RuntimeError):
    """The process that made a unit is gone, and says nothing more; another one may make it."""
