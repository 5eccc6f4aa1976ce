"""What ``skat diagnose --table`` does: many logs, each by itself, in one table."""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skat.cli.terminal import existing_path, output_console, output_file, print_line, table_of
from skat.files import whole
from skat.progress import progress_bars

if TYPE_CHECKING:
    import pandas as pd

    from skat.simulators import MujocoSimulator

# Year, month and day; of some hour, minute and second; whatever stands between them.
STAMP = re.compile(r"(\d{4})\D?(\d\d)\D?(\d\d)(?:\D?(\d\d)\D?(\d\d)(?:\D?(\d\d))?)?")


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
    found, is_first = fleet.table, ~fleet.table["log"].duplicated()
    each = found[is_first]
    failed = each[each["error"].notna()]
    for name, error in zip(failed["log"], failed["error"]):
        print_line(f"{name}: {error}")
    if len(failed) == len(logs):
        raise ValueError(f"none of {len(logs)} logs could be diagnosed.")
    with whole(table) as draft:
        getattr(found, forms[table.suffix.lower()])(draft, index=False)
    _show(found, each)
    for sentence in fleet.sentences:
        print_line(f"  {sentence}")
    print_line(f"Table: {table}")
    if len(failed):
        print_line(f"What is done is kept in {kept}, for another try at the others (--force).")
    else:
        clear_store(kept)


def _show(table: "pd.DataFrame", each: "pd.DataFrame") -> None:
    """Show the causes that hold, and in how many logs what was found; `each` has one row for each log."""
    held = table[table["held"]]
    if len(held):
        shown = ["log", "verdict", "cause", "value", "low", "high", "unit", "probability", "aliases"]
        output_console().print(table_of(held[shown]))
    counts = each["verdict"].fillna("no diagnosis").value_counts()
    print_line(f"{len(each)} logs: {', '.join(f'{count} {verdict}' for verdict, count in counts.items())}.")
    print_line(f"{held['log'].nunique()} of {len(each)} logs have a cause that holds.")
    unexplained = each.loc[each["verdict"] == "unexplained", "log"]
    if len(unexplained):
        print_line(f"Unexplained, so that no cause of theirs holds: {', '.join(unexplained)}.")
    warned = int(each["warnings"].notna().sum())
    if warned:
        print_line(f"{warned} of {len(each)} logs have warnings, in the column of that name.")


def _owners(logs: Sequence[Path], robots: str | None) -> "tuple[list[str] | None, list[Any] | None]":
    """Return the robot of each log, and when it was measured, as a regular expression finds them in its path."""
    if robots is None:
        return None, None
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
        if len(set(owners)) < len(owners):
            warnings.warn(
                "--robots has no group named time: the logs of a robot are taken in the order in which they are given.",
                stacklevel=2,
            )
        return owners, None
    return owners, [_time_of(match["time"]) for match in found if match is not None]


def _time_of(text: str) -> "pd.Timestamp":
    """Return the time that a text says from the year on, as 2026-01-05, 20260105_123000 or 2026-01-05_12-30-00."""
    import pandas as pd

    stamp = STAMP.fullmatch(text)
    said = text if stamp is None else "{}-{}-{}T{}:{}:{}".format(*stamp.groups(default="00"))
    try:
        time = pd.to_datetime(said, format="ISO8601")
    except ValueError:
        time = pd.NaT
    if pd.isna(time):
        raise ValueError(
            f"--robots finds times that are none, such as {text!r}: expected year, month and day in this order, as in "
            "2026-01-05, 20260105_123000 or 2026-01-05_12-30-00."
        )
    return time
