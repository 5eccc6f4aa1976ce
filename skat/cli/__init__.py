"""The command line: ``skat diagnose``, ``check``, ``preflight``, ``effects``, ``replay``, ``compare``, ``demo``, ..."""

import skat.cli.compared
import skat.cli.measured
import skat.cli.replay  # noqa: F401 - these register their commands
from skat.cli.commands import app

__all__ = ["app"]
