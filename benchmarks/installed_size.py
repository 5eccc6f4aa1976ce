"""Print how much an installation of skat takes: the distributions that it needs, and those of each extra.

Run in an environment that has them: ``python benchmarks/installed_size.py``. Sizes are those of the installed files as
their distributions list them, in 10^6 bytes, without what is compiled on first use.
"""

import argparse
import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

PROJECT = Path(__file__).parent.parent / "pyproject.toml"
EXTRAS = ("excel", "ros", "parquet", "hdf5", "minari", "dask")


def needed(requirements, found=None):
    """Return the names of the distributions that requirements lead to, with their sizes in bytes; None: not here."""
    from packaging.requirements import Requirement

    found = {} if found is None else found
    for text in requirements:
        requirement = Requirement(text)
        extras = requirement.extras or {""}
        if requirement.marker and not any(requirement.marker.evaluate({"extra": extra}) for extra in ("",)):
            continue
        name = re.sub(r"[-_.]+", "-", requirement.name).lower()
        if name in found:
            continue
        try:
            here = distribution(name)
        except PackageNotFoundError:
            found[name] = None
            continue
        found[name] = sum(
            path.stat().st_size for file in here.files or [] if (path := Path(str(file.locate()))).is_file()
        )
        needed(_of_extras(here.requires or [], extras), found)
    return found


def _of_extras(requirements, extras):
    """Return requirements whose marker holds for one of the extras, without that marker."""
    from packaging.requirements import Requirement

    for text in requirements:
        requirement = Requirement(text)
        if requirement.marker is None or any(
            requirement.marker.evaluate({"extra": extra}) for extra in {"", *extras}
        ):
            requirement.marker = None
            yield str(requirement)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--largest", type=int, default=6, help="so many distributions are named")
    largest = parser.parse_args().largest
    project = tomllib.loads(PROJECT.read_text())["project"]
    core = needed(project["dependencies"])
    print(
        f"{'skat':8s} {_sum(core):6.0f} MB in {len(core)} distributions; largest: {_largest(core, largest)}"
    )
    for extra in EXTRAS:
        every = needed(project["optional-dependencies"][extra], dict(core))
        more = {name: size for name, size in every.items() if name not in core}
        print(f"{extra:8s} {_sum(more):6.0f} MB more; largest: {_largest(more, largest)}")


def _sum(sizes):
    return sum(size or 0 for size in sizes.values()) / 1e6


def _largest(sizes, count):
    order = sorted(sizes, key=lambda name: -(sizes[name] or 0))[:count]
    return ", ".join(
        f"{name} {'not installed' if sizes[name] is None else f'{sizes[name] / 1e6:.0f}'}" for name in order
    )


if __name__ == "__main__":
    main()
