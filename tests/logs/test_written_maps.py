"""A map that is written is read again, and says the same; remedies of errors are such maps, too."""

import itertools
import shlex

import numpy as np
import pytest

from skat.logs import LogError, load_log, read_map, write_map
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.logs import formats


@pytest.mark.parametrize("kind", ["mcap_json", "rosbag2_mcap", "npz", "lerobot"])
def test_a_written_map_reads_the_log_as_what_was_told_did(kind, tmp_path):
    pytest.importorskip("mcap")
    simulator = MujocoSimulator(formats.ARM)
    source, told = formats.write(kind, "names", tmp_path)
    log = load_log(source, simulator, **told)
    again = load_log(source, simulator, columns=write_map(tmp_path / "map.toml", log))
    np.testing.assert_array_equal(again.X, log.X)
    np.testing.assert_array_equal(again.y, log.y)


@pytest.mark.parametrize(
    ("options", "in_python", "in_the_shell"),
    [
        ({"rate": 50.0}, "rate=50.0", "--rate 50"),
        ({"topic": "/joint states"}, "topic='/joint states'", "--topic '/joint states'"),
        (
            {"base": "fixed", "episodes": "gaps"},
            "base='fixed', episodes='gaps'",
            "--base fixed --episodes gaps",
        ),
        ({"units": "deg"}, "units='deg'", "--map '*=:deg'"),
        ({"units": {"qpos.*": "deg"}}, "units={'qpos.*': 'deg'}", "--map 'qpos.*=:deg'"),
        (
            {"columns": {"ctrl.*": "0", "qpos.a": "b:-rad"}},
            "columns={'ctrl.*': '0', 'qpos.a': 'b:-rad'}",
            "--map 'ctrl.*=0' --map qpos.a=b:-rad",
        ),
    ],
)
def test_the_remedy_of_an_error_is_told_for_python_and_for_the_shell(options, in_python, in_the_shell):
    error = LogError("log.csv", "is odd.", "Mend it.", options=options)
    assert str(error) == (
        f"log.csv: is odd. Mend it. Try load_log(..., {in_python}), on the command line {in_the_shell}."
    )
    assert str(LogError("log.csv", "is odd.", options={})) == "log.csv: is odd."
    words = shlex.split(in_the_shell)
    maps = [word for mark, word in itertools.pairwise(words) if mark == "--map"]
    units = options.get("units", {})
    said = {"*": units} if isinstance(units, str) else units
    assert read_map(maps) == options.get("columns", {}) | {name: f":{unit}" for name, unit in said.items()}


def test_a_map_is_written_once_and_read_from_either_kind_of_table(tmp_path):
    simulator = FunctionSimulator(
        lambda X: X, input_names=("q",), output_names=("q",), state_names=("q",), dt=0.01
    )
    log = load_log(
        {"t": np.arange(30) * 10.0, "a": np.arange(30.0)}, simulator, columns={"q": "a:x:2", "time": "t:ms"}
    )
    path = write_map(tmp_path / "map.toml", log)
    assert path.read_text() == (
        "# Columns of the arrays: the simulator's name, then theirs, then the unit after a colon.\n"
        '[columns]\n"q" = "a:x:2"  # told\n"time" = "t:ms"  # told\n'
    )
    with pytest.raises(FileExistsError):
        write_map(path, log)
    write_map(path, log, force=True)
    (tmp_path / "plain.toml").write_text('q = "b"\n"ctrl.u" = 0\n')
    assert read_map(["q = c:deg"], path) == {"q": "c:deg", "time": "t:ms"}
    assert read_map(path=tmp_path / "plain.toml") == {"q": "b", "ctrl.u": "0"}
    with pytest.raises(TypeError, match="columns must be a mapping such as"):
        load_log({"q": np.arange(30.0)}, simulator, columns=["q"])
