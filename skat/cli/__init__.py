"""The command line: ``skat demo``, ``skat diagnose``, ``skat transport``, ``skat experiment``."""

from skat.cli.commands import app

__all__ = ["app"]
