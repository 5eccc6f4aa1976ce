import ast
import functools
from pathlib import Path

import numpy as np
import pytest

from skat.logs import load_log
from skat.simulators import MujocoSimulator
from tests.logs import formats

pytest.importorskip("pyarrow")
pytest.importorskip("rosbags")
pytest.importorskip("mcap")
pytest.importorskip("minari")


@pytest.fixture(scope="module")
def arm():
    return MujocoSimulator(formats.ARM)


@pytest.fixture(scope="module")
def documented(arm, tmp_path_factory):
    """A function of a state that reads its documented CSV, at the first call."""

    def read(state):
        told = {"units": "deg"} if state == "degrees" else {}
        return load_log(formats.documented(tmp_path_factory.mktemp(state) / "log.csv", state), arm, **told)

    return functools.cache(read)


@pytest.fixture(scope="module")
def clean(documented):
    return documented("clean")


def test_the_writer_knows_nothing_of_skat():
    tree = ast.parse(Path(formats.__file__).read_text())
    modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    modules += [name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names]
    assert not [module for module in modules if module.startswith("skat")]


@pytest.mark.parametrize("state", formats.STATES)
@pytest.mark.parametrize("kind", formats.FORMATS)
def test_a_log_in_any_format_and_state_is_that_of_the_documented_csv(
    kind, state, arm, documented, clean, tmp_path
):
    """Equal to the CSV in the same state; and that to the clean one, as far as it was measured."""
    source, options = formats.write(kind, state, tmp_path)
    log = load_log(source, arm, **options)
    same = documented(state)
    # The last command of a Minari episode is not recorded, and no transition begins at it.
    np.testing.assert_allclose(log.X, same.X, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(log.y, same.y, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(log.groups, same.groups)
    assert log.dt == same.dt == clean.dt
    expected = dict.fromkeys(formats.STATES, 1) | {"gaps": 2}
    assert len(log.group_names) == expected[state]
    compare(log, clean, arm, state)


def compare(log, clean, arm, state):
    if state == "gaps":
        at = np.delete(np.arange(len(clean)), formats.ROWS // 2 - 1)
        np.testing.assert_allclose(log.X, clean.X[at], rtol=1e-12, atol=1e-12)
        return
    seen = np.isfinite(log.X)
    if state == "positions":
        assert log.unmeasured == ("qvel.shoulder", "qvel.elbow")
    elif state == "lost":
        assert (~seen).any(axis=1).sum() == 4
        assert seen[:, 4:].all()
    elif state == "jitter":
        for column, name in enumerate(arm.state_names):
            missed = log.X[:, column] - clean.X[:, column]
            assert np.sqrt(np.mean(missed**2)) <= log.interpolation[name]
        return
    else:
        assert seen.all()
    states = slice(0, 4) if state == "lost" else slice(None)
    np.testing.assert_allclose(
        np.where(seen, log.X, 0)[:, states], np.where(seen, clean.X, 0)[:, states], rtol=1e-12, atol=1e-12
    )


MORE = {
    "MCAP of protobuf": lambda folder: formats.mcap_protobuf(folder, "clean"),
    "LeRobot 2.1": lambda folder: formats.lerobot(folder, "clean", "v2.1"),
    "Minari in Arrow": formats.minari_arrow,
    "HDF5 with a group an episode": formats.hdf5_episodes,
    "Parquet of lists": formats.parquet_lists,
    "a folder of tables": formats.tables,
    "PyTorch": formats.torch_tensors,
    "MCAP of nested messages": formats.mcap_mixed,
    "LeRobot with names in a mapping": formats.lerobot_motors,
    "a group of an HDF5": formats.hdf5_groups,
}


@pytest.mark.parametrize("name", MORE)
def test_further_formats_are_that_of_the_documented_csv_too(name, arm, clean, tmp_path):
    source, options = MORE[name](tmp_path)
    log = load_log(source, arm, **options)
    expected = clean.X.copy()
    if name == "Parquet of lists":
        expected[40, :2] = np.nan
    if name == "HDF5 with a group an episode":
        assert log.group_names == ("run_1", "run_2")
        expected = np.delete(expected, 79, axis=0)
    np.testing.assert_allclose(log.X, expected, rtol=1e-12, atol=1e-12)


def test_columns_of_a_bag_without_description_are_those_with_one(arm, clean, tmp_path):
    source, _ = formats.write("rosbag2_sqlite3", "clean", tmp_path)
    (source / "metadata.yaml").unlink()
    np.testing.assert_allclose(load_log(source, arm).X, clean.X, rtol=1e-12, atol=1e-12)
    bare = next(source.glob("*.db3"))
    np.testing.assert_allclose(load_log(bare, arm).X, clean.X, rtol=1e-12, atol=1e-12)


def test_a_minari_data_set_does_not_run_what_it_names(arm, tmp_path):
    """Minari would make the environment, and so import any module, where a description lacks its spaces."""
    import json

    for kind, (source, _) in {
        "hdf5": formats.write("minari", "clean", tmp_path),
        "arrow": formats.minari_arrow(tmp_path),
    }.items():
        path = source / "data" / "metadata.json"
        metadata = json.loads(path.read_text())
        del metadata["observation_space"]
        metadata["env_spec"] = json.dumps({"id": "Trap-v0", "entry_point": "antigravity:fly"})
        path.write_text(json.dumps(metadata))
        if kind == "hdf5":
            assert len(load_log(source, arm)) > 100
        else:
            with pytest.raises(ValueError, match="a program that the data set names would be run"):
                load_log(source, arm)
    import sys

    assert "antigravity" not in sys.modules
