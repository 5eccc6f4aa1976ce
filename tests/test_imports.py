"""Imports point one way, and importing the package loads nothing heavy."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "skat"

# Part -> the parts of skat it may import. What is not listed is not allowed.
ALLOWED = {
    "_compat": set(),
    "files": set(),
    "progress": set(),
    "episodes": set(),
    "rounding": set(),
    "gaussian": {"_compat"},
    "metrics": {"_compat", "gaussian"},
    "transport": {"_compat", "gaussian", "metrics"},
    "torch_arrays": set(),
    "effects": set(),
    "simulators": {"effects", "files"},
    "datasets": {"episodes", "effects", "simulators", "torch_arrays"},
    "logs": {"episodes", "files", "simulators", "torch_arrays"},
    "diagnosis": {
        "_compat",
        "files",
        "episodes",
        "rounding",
        "effects",
        "gaussian",
        "transport",
        "metrics",
        "simulators",
        "plotting",
        "replay",
    },
    "fleet": {"files", "effects", "simulators", "logs", "diagnosis"},
    "replay": {"files"},
    "plotting": {"rounding", "gaussian", "transport", "metrics"},
    "experiments": {
        "_compat",
        "gaussian",
        "transport",
        "metrics",
        "plotting",
        "effects",
        "simulators",
        "datasets",
        "diagnosis",
    },
    "cli": {
        "files",
        "progress",
        "rounding",
        "gaussian",
        "transport",
        "metrics",
        "plotting",
        "effects",
        "simulators",
        "datasets",
        "logs",
        "diagnosis",
        "fleet",
        "experiments",
        "replay",
        "",
    },
    "__main__": {"cli"},
    "": {"transport"},
}
MAY_IMPORT_MUJOCO = {"effects", "simulators", "datasets", "diagnosis", "replay"}
IMPORTED_WHERE_USED = {
    "ot",
    "matplotlib",
    "pooch",
    "dask",
    "distributed",
    "torch",
    "gymnasium",
    "openpyxl",
    "PIL",
}
IMPORTED_WHERE_USED |= {
    "pyarrow",
    "polars",
    "h5py",
    "rosbags",
    "mcap",
    "mcap_ros2",
    "mcap_protobuf",
    "minari",
}


def part_of(path):
    return path.relative_to(PACKAGE).with_suffix("").parts[0].replace("__init__", "")


def imported_modules(tree):
    """Yield (dotted module, whether it is imported as the module loads)."""
    deferred = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or _for_types(node)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, id(node) not in deferred
        elif isinstance(node, ast.ImportFrom):
            yield (
                (node.module or "") if not node.level else "." * node.level + (node.module or ""),
                id(node) not in deferred,
            )
            if node.module == "skat":
                for alias in node.names:
                    yield f"skat.{alias.name}", id(node) not in deferred


def _for_types(node):
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


FILES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_one_way(path):
    part = part_of(path)
    for module, at_load in imported_modules(ast.parse(path.read_text())):
        assert not module.startswith("."), f"{path.name}: write imports in full, not {module}"
        top, *rest = module.split(".")
        if top == "skat" and rest:
            other = rest[0]
            is_module = (PACKAGE / other).is_dir() or (PACKAGE / f"{other}.py").exists()
            if is_module and other != part:
                assert other in ALLOWED[part], (
                    f"{path.name} imports skat.{other}; allowed: {sorted(ALLOWED[part])}"
                )
        elif top == "mujoco":
            assert part in MAY_IMPORT_MUJOCO, f"{path.name} imports mujoco"
        if at_load:
            assert top not in IMPORTED_WHERE_USED, (
                f"{path.name} imports {top} as it loads; import it where it is used"
            )


def test_importing_the_package_loads_nothing_but_its_names():
    code = (
        "import sys, skat\n"
        "loaded = {name.partition('.')[0] for name in sys.modules}\n"
        "assert not loaded & {'numpy', 'scipy', 'sklearn'}, loaded\n"
        "from skat import *\n"
        "assert all(name in dir(skat) and name in globals() for name in skat.__all__)\n"
        "assert AffineTransport is skat.AffineTransport\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_transports_load_numpy_scipy_and_sklearn_only():
    code = (
        "import numpy, scipy, sklearn, sklearn.base, sklearn.utils.validation, sys\n"
        "before = sklearn.get_config(), numpy.geterr()\n"
        "loaded = set(sys.modules)  # scikit-learn loads pandas where it is installed\n"
        "from skat import AffineTransport, CORAL\n"
        "heavy = {'ot', 'mujoco', 'matplotlib', 'pandas', 'gymnasium', 'pooch', 'dask', 'torch'}\n"
        "heavy |= {'typer', 'rich', 'jinja2'}\n"
        "assert not heavy & (set(sys.modules) - loaded), heavy & (set(sys.modules) - loaded)\n"
        "assert before == (sklearn.get_config(), numpy.geterr())\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
