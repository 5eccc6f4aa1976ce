"""The command line: ``skat demo``, ``diagnose``, ``effects``, ``preflight``, ``transport``, ``experiment``."""

from skat.cli.commands import app

__all__ = ["app"]
