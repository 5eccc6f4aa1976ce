"""Progress of long work, as it suits where it is shown: a terminal, a notebook, or a file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from time import monotonic
from typing import Any

# Called with the name of the stage, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]
# Seconds between two changes of what a notebook shows.
PATIENCE_S = 0.1


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Show the stages of the work; yield the function to pass as ``progress``.

    On a terminal and in a notebook each stage has a bar; elsewhere its name is printed as it begins, to standard error.

    Yields
    ------
    callable
        To be called with (stage, done, total).

    Examples
    --------
    >>> with progress_bars() as progress:
    ...     for done in range(3):
    ...         progress("simulate", done + 1, 3)
    """
    from rich.console import Console

    if _in_notebook():
        with _notebook_bars() as progress:
            yield progress
        return
    console = Console(file=sys.stderr, highlight=False)
    if console.is_terminal:
        with _terminal_bars(console) as progress:
            yield progress
    else:
        yield _stage_printer()


def _in_notebook() -> bool:
    """Whether a kernel runs this, whose front end shows HTML."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    return getattr(get_ipython(), "kernel", None) is not None


@contextmanager
def _terminal_bars(console: Any) -> Iterator[Progress]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    tasks: dict[str, Any] = {}
    # Names of effects have brackets.
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield report


@contextmanager
def _notebook_bars() -> Iterator[Progress]:
    """Show one table that changes in its place, and in the end says how long it took."""
    from IPython.display import HTML, display

    stages: dict[str, tuple[int, int]] = {}
    start = shown = monotonic()
    handle = display(HTML(_bars(stages)), display_id=True)

    def report(stage: str, done: int, total: int) -> None:
        nonlocal shown
        is_new, stages[stage] = stage not in stages, (done, total)
        if is_new or done >= total or monotonic() - shown > PATIENCE_S:
            shown = monotonic()
            handle.update(HTML(_bars(stages)))

    try:
        yield report
    except BaseException:
        handle.update(HTML(_bars(stages)))
        raise
    handle.update(HTML(f"<span>{len(stages)} stages in {monotonic() - start:.1f} s</span>"))


def _bars(stages: dict[str, tuple[int, int]]) -> str:
    rows = "".join(
        f'<tr><td style="text-align:left">{escape(stage)}</td><td><progress value="{done}" max="{max(total, 1)}" '
        f'aria-label="{escape(stage, quote=True)}"></progress></td><td>{done} of {total}</td></tr>'
        for stage, (done, total) in stages.items()
    )
    return f"<table>{rows}</table>" if rows else "<span>begins</span>"


def _stage_printer() -> Progress:
    begun: set[str] = set()

    def report(stage: str, done: int, total: int) -> None:
        if stage not in begun:
            begun.add(stage)
            print(f"{stage} ...", file=sys.stderr, flush=True)

    return report
