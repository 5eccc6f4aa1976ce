"""The command line: ``skat diagnose``, ``check``, ``preflight``, ``effects``, ``transport``, ``demo``, ..."""

import skat.cli.measured  # noqa: F401 - registers its commands
from skat.cli.commands import app

__all__ = ["app"]
