"""The command that takes findings: ``skat compare``."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skat.cli.commands import Force, app
from skat.cli.terminal import clear_errors, existing_file, output_console, output_file, print_line, table_of
from skat.files import whole

if TYPE_CHECKING:
    import pandas as pd


@app.command()
def compare(
    findings: Annotated[
        list[Path],
        typer.Argument(metavar="FINDINGS.json...", help="Findings, as `skat diagnose --json` writes them."),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.csv", help="CSV file for the table.")
    ] = None,
    force: Force = False,
) -> None:
    """Several logs of one robot: side by side, what each names, and whether they agree."""
    with clear_errors():
        from skat.diagnosis.report.agreement import agreement_sentences, compare_findings

        output = None if output is None else output_file(output, force=force)
        found = [_read(path) for path in findings]
        names = _names(findings)
        table = compare_findings(found, names=names)
        output_console().print(table_of(_logs(dict(zip(names, found)))))
        if len(table):
            output_console().print(table_of(_side_by_side(table, names)))
        else:
            print_line("No log names a cause.")
        for sentence in agreement_sentences(table):
            print_line(f"  {sentence}")
        if output is not None:
            with whole(output) as draft:
                table.to_csv(draft, index=False)
            print_line(f"Table: {output}")


def _read(path: Path) -> Any:
    from skat.diagnosis.report.agreement import check_findings

    text = existing_file(path, "findings in JSON").read_bytes()
    try:
        content = json.loads(text)
    except ValueError as error:
        raise ValueError(
            f"{path} is no JSON ({error}); expected findings, as `skat diagnose --json` writes them."
        ) from error
    check_findings(content, str(path))
    return content


def _names(paths: Sequence[Path]) -> list[str]:
    """Return short names of files: without folder and ending where these do not tell them apart."""
    alike = Counter(path.stem for path in paths)
    return [path.stem if alike[path.stem] == 1 else str(path) for path in paths]


def _logs(found: Mapping[str, Mapping[str, Any]]) -> "pd.DataFrame":
    import pandas as pd

    logs = [one.get("log") or {} for one in found.values()]
    return pd.DataFrame(
        {
            "findings": list(found),
            "log": [log.get("source", "") for log in logs],
            "rows": [log.get("rows", one.get("rows_fitted", "")) for log, one in zip(logs, found.values())],
            "verdict": [
                one["verdict"] + (" (a first look)" if one.get("first_look") else "")
                for one in found.values()
            ],
            "excess explained": [_explained(one.get("gain")) for one in found.values()],
        }
    )


def _explained(gain: Mapping[str, Any] | None) -> str:
    """Return which share of the error's excess the causes explain, with its interval where that says something."""
    share, nominal, floor = ((gain or {}).get(name) for name in ("explained", "nominal", "floor"))
    if gain is None or share is None or nominal is None or floor is None:
        return "not measured"
    if nominal <= floor:
        return "there is none"
    text = f"{100 * share:.0f} %"
    low, high = gain.get("interval") or (None, None)
    if low is None or high is None or high - low > 1:
        return f"{text} (no interval)"
    return f"{text} ({100 * low:.0f} to {100 * high:.0f} %)"


def _side_by_side(table: "pd.DataFrame", names: Sequence[str]) -> "pd.DataFrame":
    import pandas as pd

    from skat.diagnosis.report.sentences import p_text

    rows = table.to_dict("records")
    return pd.DataFrame(
        {
            "cause": table["cause"],
            "unit": table["unit"],
            **{name: [_cell(row, name) for row in rows] for name in names},
            "agreement": [
                ""
                if row["agreement"] == "not compared"
                else f"{row['agreement']}, {p_text(row['p_corrected'])}"
                for row in rows
            ],
        }
    )


def _cell(row: Mapping[Any, Any], name: str) -> str:
    """Return in text what a log says of a cause: its value with the 95 % interval, or why there is none."""
    from skat.diagnosis.agreement import NAMED
    from skat.rounding import interval_text, number, size_text

    value, low, high, status = (row[f"{what} in {name}"] for what in ("value", "low", "high", "status"))
    if status == NAMED:
        return f"{size_text(value, (low, high))} ({interval_text((low, high))})"
    if status.startswith("alias of"):
        return f"- ({status})"
    return status if value != value else f"{number(value)} ({status})"
