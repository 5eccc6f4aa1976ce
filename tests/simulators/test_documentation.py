"""The tables of the documentation say what the code does."""

from pathlib import Path

import pytest

from skat.effects import FAMILIES
from skat.simulators import make_simulator
from skat.simulators.machines import MACHINES

PAGE = Path(__file__).parents[2] / "docs" / "simulators.rst"
HEADINGS = {"hopper": "Hopper", "halfcheetah": "HalfCheetah", "ant": "Ant"}


def section(heading):
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    start = next(
        index for index, line in enumerate(lines[:-1]) if line == heading and lines[index + 1][:2] == "~~"
    )
    rows = []
    for line in lines[start + 2 :]:
        if line.startswith(("~~", "--")):
            break
        rows.append([cell.strip().strip("`") for cell in line.split(",")])
    return [row for row in rows if len(row) == 6 and row[0].isdigit()]


@pytest.mark.parametrize("name", HEADINGS)
def test_state_tables_have_the_columns_of_the_simulator(name):
    robot, table = make_simulator(name), section(HEADINGS[name])
    assert tuple(row[1] for row in table) == robot.input_names
    assert [int(row[0]) for row in table] == list(range(len(robot.input_names)))
    units = {effect.target: effect.unit for effect in robot.effects() if effect.family == "bias"}
    assert {row[1]: row[5] for row in table if row[1] in units} == units


def test_every_effect_family_is_documented():
    text = PAGE.read_text(encoding="utf-8")
    names = (*HEADINGS, "puck", *MACHINES)
    families = {effect.family for name in names for effect in make_simulator(name).effects(also="all")}
    assert not [family for family in {*families, *FAMILIES} if f"``{family}" not in text]


@pytest.mark.parametrize("name", MACHINES)
def test_machines_are_documented_with_their_transition(name):
    rows = [line.split(",") for line in PAGE.read_text(encoding="utf-8").splitlines()]
    (row,) = (row for row in rows if row[0].strip() == name and len(row) > 3)
    assert float(row[1].split()[0]) == pytest.approx(1000 * make_simulator(name).dt)
