"""What `studies.py` writes for the pages: tables, numbers to be put into sentences, and figures.

A page includes ``<study>.inc``, which defines its numbers (``|nominal|``, ``|extended|``, ...), and tables
``<study>_*.csv``.
"""

import csv
import json
from pathlib import Path

import numpy as np

from skat.plotting.style import AFTER, BEFORE, MEASURED, trim

PAGES = Path(__file__).parents[1] / "docs" / "studies"
LABELS = {
    "nominal": "model as given",
    "extended": "skat's extended model",
    "least squares": "least squares, list given",
    "mujoco.sysid": "mujoco.sysid, list given",
}
# Of a curve: its colour, width and name in the legend.
CURVES = {
    "nominal": (BEFORE, 1.2, "as given"),
    "extended": (AFTER, 1.2, "extended"),
    "least squares": ("#009E73", 0.9, "least squares"),
}
TITLES = {
    "so101": "SO-101, five motions",
    "go2_air": "Go2 in the air",
    "double_pendulum": "Two-link arm",
    "pendulum": "Pendulum, another load",
    "ur10": "UR10 from a bag",
}


def write(name, found, folder):
    """Write the JSON of a study and what its page includes."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = found.pop("paths")
    (folder / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n")
    write_table(folder / f"{name}_errors.csv", *errors_table(found))
    write_table(folder / f"{name}_causes.csv", *causes_table(found["causes"]))
    write_table(folder / f"{name}_joints.csv", *joints_table(found["joints"]))
    if "not_named" in found:
        write_table(folder / f"{name}_not_named.csv", *not_named_table(found["not_named"]))
    for extra, table in more_tables(found).items():
        write_table(folder / f"{name}_{extra}.csv", *table)
    (folder / f"{name}.inc").write_text(substitutions(numbers_of(found)))
    draw_paths(paths, found["shown"], folder / f"{name}_open_loop.png")
    draw_causes(found["causes"], folder / f"{name}_causes.png")


def write_table(path, header, rows):
    """Write a table as CSV."""
    with Path(path).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def substitutions(numbers):
    """Return numbers, by name, as reStructuredText substitutions."""
    return "".join(f".. |{name}| replace:: {text}\n" for name, text in numbers.items())


def shown(value, digits=3):
    """Return a number in so many digits, without an exponent where that is shorter."""
    if value is None or not np.isfinite(value):
        return "lost" if value is not None else ""
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e6 else text


# -- numbers and tables ------------------------------------------------------------------------------------------------


def numbers_of(found):
    """Return the numbers that sentences of a page may use, as texts by name."""
    errors = found["errors"]
    unit = 1e3
    numbers = {
        "commit": found["commit"],
        "seconds": f"{found['seconds']:,.0f}",
        "minutes": shown(found["seconds"] / 60, 2),
        "rows": f"{found['rows']:,}",
        "rows_offered": f"{found['rows_offered']:,}",
        "rows_tested": f"{found['rows_tested']:,}",
        "verdict": f"“{found['verdict']}”",
        "causes": "one cause" if len(found["causes"]) == 1 else f"{len(found['causes'])} causes",
        "nominal": shown(unit * errors["nominal"]),
        "extended": shown(unit * errors["extended"]),
        "share_of_nominal": shown(errors["extended"] / errors["nominal"]),
    }
    for name, place in (("least squares", "least_squares"), ("mujoco.sysid", "sysid")):
        if name in errors:
            numbers[place] = shown(unit * errors[name])
            numbers[f"ratio_to_{place}"] = shown(errors["extended"] / errors[name])
            numbers[f"{place}_seconds"] = f"{found['peers'][name]['seconds']:,.0f}"
    return numbers | {name: str(text) for name, text in found.get("numbers", {}).items()}


def errors_table(found):
    """Return header and rows: of each model its error on what it has not seen, and what it took."""
    seconds = {"extended": found["seconds"]} | {name: one["seconds"] for name, one in found["peers"].items()}
    what = "rms" if found["measure"] == "rms" else "mean absolute"
    nominal = found["errors"]["nominal"]
    rows = []
    for name, error in found["errors"].items():
        took = f"{seconds[name]:,.0f}" if name in seconds else ""
        rows.append([LABELS.get(name, name), shown(1e3 * error), shown(error / nominal), took])
    return ["model", f"{what} error, open loop (mrad)", "of the model's as given", "fit (s)"], rows


def causes_table(causes):
    """Return header and rows of causes with intervals, most telling first."""
    from skat.rounding import interval_text, size_text

    rows = []
    for one in causes:
        low_high = tuple(one["interval"])
        unit = "" if one["unit"] == "1" else f" {one['unit']}"
        size = f"{size_text(one['value'], low_high)}{unit} ({interval_text(low_high)})"
        aliases = ", ".join(f"``{alias}``" for alias in one["aliases"]) or "none"
        rows.append([f"``{one['name']}``", size, probability(one["probability"]), aliases])
    return ["cause", "size (95 %)", "probability", "aliases"], rows or [["none", "", "", ""]]


def probability(value):
    """Return a probability in three digits, and as a bound where they do not tell it from 0 or 1."""
    if value > 0.999:
        return "> .999"
    return "< .001" if value < 0.001 else f"{value:.3f}".lstrip("0")


def joints_table(said):
    """Return header and rows: of each joint and quantity what each model has; only where one differs from the first."""
    models = list(said)
    rows = []
    for joint in said[models[0]]:
        for quantity in said[models[0]][joint]:
            values = [said[model][joint].get(quantity) if joint in said[model] else None for model in models]
            told = [value for value in values if value is not None]
            if max(told) - min(told) > 1e-9:
                rows.append([joint, quantity, *(shown(value) for value in values)])
    return ["joint", "quantity", *(LABELS.get(model, model) for model in models)], rows


def not_named_table(rows):
    """Return header and rows: of families of effects that are not named how small a one would have been."""
    return ["not named", "smallest", "nearest alias"], [
        [f"``{one['effect']}``", f"{shown(one['smallest'])} {'' if one['unit'] == '1' else one['unit']}".strip(),
         f"``{one['alias']}``"]
        for one in rows
    ]  # fmt: skip


def more_tables(found):
    """Return tables that only some studies have, by name."""
    models = list(found["errors_by_joint"])
    rows = [
        [joint, *(shown(1e3 * found["errors_by_joint"][model][joint]) for model in models)]
        for joint in found["errors_by_joint"][models[0]]
    ]
    tables = {"errors_by_joint": (["joint", *(LABELS.get(model, model) for model in models)], rows)}
    if "thirds" in found:
        tables["thirds"] = thirds_table(found["thirds"])
    if "changes" in found:
        rows = []
        for asked, one in found["changes"].items():
            _, causes = causes_table(one["causes"])
            rows += [[asked, one["verdict"], *cause[:2], cause[3]] for cause in causes]
        tables["changes"] = ["asked", "verdict", "change", "size (95 %)", "aliases"], rows
    for again in ("heavier", "again"):
        if again in found:
            tables[again] = causes_table(found[again]["causes"])
    if "efforts" in found:
        shares = found["efforts"]["share"]
        joints = list(found["joints"]["nominal"])
        by_joint = found["efforts"]["by_joint"]
        tables["efforts"] = (
            ["model", "in all, share of the spread", *(f"{joint}" for joint in joints)],
            [
                [LABELS.get(name, name), shown(share), *map(shown, by_joint[name])]
                for name, share in shares.items()
            ],
        )
    return tables


def thirds_table(rows):
    """Return header and rows: of each cause what each part of a log says, and whether the parts agree."""
    names = [key.removeprefix("value in ") for key in rows[0] if key.startswith("value in ")] if rows else []
    told = []
    for row in rows:
        sizes = []
        for name in names:
            value, low, high = (row[f"{what} in {name}"] for what in ("value", "low", "high"))
            status = row[f"status in {name}"]
            sizes.append(
                f"{shown(value)} [{shown(low)}, {shown(high)}]" if None not in (value, low, high) else status
            )
        told.append([f"``{row['cause']}``", *sizes, row["agreement"]])
    return ["cause", *names, "agreement"], told


def write_summary(folder):
    """Write the table of all studies that have a JSON."""
    rows = []
    for name, title in TITLES.items():
        file = Path(folder) / f"{name}.json"
        if file.exists():
            found = json.loads(file.read_text())
            errors = found["errors"]
            squares = errors.get("least squares of the benchmark", errors.get("least squares"))
            rows.append(
                [
                    f":doc:`{title} <{name}>`",
                    found["verdict"],
                    str(len(found["causes"])),
                    *(shown(1e3 * error) for error in (errors["nominal"], errors["extended"], squares)),
                    f"{found['seconds']:,.0f}",
                    found["commit"],
                ]
            )
    header = [
        "study",
        "verdict",
        "causes",
        "model as given (mrad)",
        "extended (mrad)",
        "least squares (mrad)",
    ]
    write_table(Path(folder) / "summary.csv", [*header, "fit (s)", "commit"], rows)


# -- figures -----------------------------------------------------------------------------------------------------------


def draw_paths(paths, what, file):
    """Draw angles in open loop beside those measured: one panel a joint."""
    from matplotlib import pyplot

    joints = what["joints"]
    figure, axes = pyplot.subplots(
        len(joints),
        1,
        figsize=(7.2, 0.9 + 1.6 * len(joints)),
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    for ax, joint in zip(axes[:, 0], joints, strict=True):
        place = paths["joints"].index(joint)
        ax.plot(
            paths["time"],
            paths["measured"][:, place],
            color=MEASURED,
            linewidth=2.6,
            alpha=0.55,
            label="measured",
        )
        for name, (colour, width, label) in CURVES.items():
            if name in paths["models"]:
                time, angles = paths["models"][name]
                ax.plot(time, angles[:, place], color=colour, linewidth=width, label=label)
        ax.set_ylabel(f"{joint.removesuffix('_joint')}\n(rad)")
        trim(ax)
    figure.align_ylabels()
    axes[-1, 0].set_xlabel("time (s)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(file, dpi=95)
    pyplot.close(figure)


def draw_causes(causes, file):
    """Draw causes with their intervals, each on a scale of its own."""
    from matplotlib import pyplot

    from skat.plotting import CauseDisplay

    display = CauseDisplay(
        names=[one["name"] for one in causes],
        units=[one["unit"] for one in causes],
        values=[one["value"] for one in causes],
        neutrals=[one["neutral"] for one in causes],
        intervals=[tuple(one["interval"]) for one in causes],
    ).plot()
    display.figure_.savefig(file, dpi=100, bbox_inches="tight")
    pyplot.close(display.figure_)
