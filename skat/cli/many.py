"""What ``skat diagnose --table`` does: many logs, each by itself, in one table."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skat.cli.terminal import existing_path, output_console, output_file, print_line, table_of
from skat.files import whole
from skat.progress import progress_bars

if TYPE_CHECKING:
    from skat.simulators import MujocoSimulator


def diagnose_fleet(
    logs: Sequence[Path],
    simulator: "MujocoSimulator",
    table: Path,
    robots: str | None,
    reading: Mapping[str, Any],
    parameters: Mapping[str, Any],
    jobs: int | None,
    force: bool,
) -> None:
    """Diagnose each log by itself, show and write the table of all; what is done is kept beside it until all is."""
    from skat.fleet import diagnose_many
    from skat.fleet.many import clear_store

    forms = {".parquet": "to_parquet", ".csv": "to_csv"}
    if table.suffix.lower() not in forms:
        raise ValueError(f"--table {table}: expected a name that ends in {' or '.join(forms)}.")
    table = output_file(table, force=force)
    for path in logs:
        existing_path(path, "a log")
    owners, times = _owners(logs, robots)
    kept = table.with_name(table.name + ".part")
    with progress_bars() as progress:
        fleet = diagnose_many(
            logs,
            simulator,
            robots=owners,
            times=times,
            store=kept,
            reading=reading,
            n_jobs=jobs,
            progress=progress,
            **parameters,
        )
    with whole(table) as draft:
        getattr(fleet.table, forms[table.suffix.lower()])(draft, index=False)
    clear_store(kept)
    found = fleet.table[fleet.table["held"]]
    if len(found):
        shown = ["log", "cause", "value", "low", "high", "unit", "probability", "aliases"]
        output_console().print(table_of(found[shown]))
    failed = fleet.table[fleet.table["error"].notna()]
    for name, error in zip(failed["log"], failed["error"]):
        print_line(f"{name}: {error}")
    print_line(f"{found['log'].nunique()} of {len(logs)} logs have a cause that holds.")
    for sentence in fleet.sentences:
        print_line(f"  {sentence}")
    print_line(f"Table: {table}")


def _owners(logs: Sequence[Path], robots: str | None) -> "tuple[list[str] | None, list[Any] | None]":
    """Return the robot of each log, and when it was measured, as a regular expression finds them in its path."""
    if robots is None:
        return None, None
    import pandas as pd

    try:
        pattern = re.compile(robots)
    except re.error as error:
        raise ValueError(f"--robots {robots!r} is no regular expression: {error}.") from error
    if "robot" not in pattern.groupindex:
        raise ValueError(f"--robots {robots!r} has no group named robot, as in '(?P<robot>r\\d+)'.")
    found = [pattern.search(str(path)) for path in logs]
    for path, match in zip(logs, found):
        if match is None:
            raise ValueError(f"--robots {robots!r} finds nothing in {path}.")
    owners = [match["robot"] for match in found if match is not None]
    if "time" not in pattern.groupindex:
        return owners, None
    texts = [match["time"] for match in found if match is not None]
    try:
        return owners, list(pd.to_datetime(pd.Series(texts)))
    except ValueError as error:
        raise ValueError(
            f"--robots {robots!r} finds times that are none, such as {texts[0]!r}: {error}."
        ) from error
