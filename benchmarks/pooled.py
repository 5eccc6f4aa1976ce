"""What has to hold over all tables together: coverage of intervals, and probabilities that are not too high.

Reads the lines of one hash or commit from ``results``, runs nothing::

    python benchmarks/pooled.py
    python benchmarks/pooled.py --source <hash or commit>
"""

import argparse

import tables
from rich.console import Console

# Of sensors and random forces apart, intervals have wider bounds of their own.
SINGLES = ("hidden_effects", "other_robots", "sensors", "process_noise", "servo_arm")
# Drawn from the prior, and judged in its own table.
CALIBRATED = "probabilities"
# Measured machines, of which nobody knows all that a model lacks: a name that is not published may be right.
OPEN = ("measured", "across")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--source", help="hash or commit of the lines to count; by default of the sources at hand"
    )
    source = parser.parse_args().source
    counted = {source} if source else {tables.source_hash(), tables.source_hash(of_changes=True)}
    lines = {}
    for path in sorted(tables.RESULTS.glob("*.jsonl")):
        found = tables.lines_of(path)
        lines[path.stem] = [_read(x) for x in found if counted & {x.get("source"), x.get("commit")}]
    shown = tables.Figures(f"all tables, sources {' and '.join(sorted(counted))}")
    singles = [line for name in SINGLES for line in lines.get(name, []) if len(line["truth"]) == 1]
    covered = [one for line in singles for one in tables.in_interval(line)]
    shown.share("single cases: intervals that cover", covered, "93 to 97 %, >= 400")
    for name in SINGLES:
        shown.share(
            f"... {name}", [one for x in singles if x in lines.get(name, []) for one in tables.in_interval(x)]
        )
    judged = [line for name, some in lines.items() if name != CALIBRATED for line in some]
    shown.probabilities([x for x in judged if not {x["table"], x.get("what")} & set(OPEN)])
    shown.costs([line for some in lines.values() for line in some])
    Console().print(shown.table)


def _read(line):
    """Return a line with its truth as a mapping; `hidden_effects` has pairs."""
    return line if isinstance(line["truth"], dict) else {**line, "truth": dict(line["truth"])}


if __name__ == "__main__":
    main()
