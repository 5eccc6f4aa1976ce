"""Print the processor time of ``skat --help`` and of imports, each in a process of its own, least of some runs.

The peer in the same run is the import of scikit-learn, which skat itself needs for its estimators.
"""

import argparse
import resource
import subprocess
import sys

COMMANDS = {
    "python": ["-c", "pass"],
    "skat --version": ["-m", "skat", "--version"],
    "skat --help": ["-m", "skat", "--help"],
    "import skat": ["-c", "import skat"],
    "import sklearn.base": ["-c", "import sklearn.base"],
    "from skat import AffineTransport": ["-c", "from skat import AffineTransport"],
    "import skat.diagnosis": ["-c", "import skat.diagnosis"],
}


def processor_seconds(arguments):
    """Return the user and system time of a run of Python, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    for name, arguments in COMMANDS.items():
        print(f"{name:34s} {min(processor_seconds(arguments) for _ in range(runs)):.2f} s")


if __name__ == "__main__":
    main()
