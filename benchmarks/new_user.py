"""Do what README and the pages say, as a new user does: in a fresh environment, from the built wheel.

Every line that begins with ``$`` and every block of Python of README, the tutorial and the how-to pages is run in the
order in which it stands, in an empty folder a page; ``pip install skat`` installs the wheel, which is built first.
What a reader would have at hand is put into the folder before: the files that ``docs/arm_logs.py`` makes. At the end
the extended model is loaded in plain MuJoCo, by an interpreter that cannot import skat, and the report is opened: by
a browser without a window where there is one, else by a parser of HTML. Lines for a checkout (``make``) or a shell
are left out and said.

    python benchmarks/new_user.py                  # half an hour of one core: each diagnosis as it is written
    python benchmarks/new_user.py --quick          # one effect for each diagnosis

The first line names the sources that were tried: a hash of the package, the pages and what is put at hand.
"""

import argparse
import hashlib
import html.parser
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = [
    "README.md",
    "docs/tutorial.rst",
    *(
        f"docs/how_to/{page}.rst"
        for page in (
            "bags",
            "lerobot",
            "positions_only",
            "unexplained",
            "changed",
            "own_effect",
            "own_simulator",
            "pipeline",
            "cluster",
            "gpu_array",
        )
    ),
]
NOT_FOR_A_WHEEL = ("make ", "source ", "export ", "git ")
# What a page writes for its own tests, and what it tells the reader to write there.
FOR_THE_READER = {"import array_api_strict as xp  # import torch as xp": "import torch as xp"}
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def lines_of(page):
    """Return what a page tells to type, in order: ("console", line) and ("python", block)."""
    text = (ROOT / page).read_text("utf-8")
    found = []
    if page.endswith(".md"):
        for match in re.finditer(r"```(console|python)\n(.*?)```", text, re.DOTALL):
            kind, block = match.groups()
            if kind == "python":
                found.append(("python", block))
            else:
                found += [("console", line[2:]) for line in block.splitlines() if line.startswith("$ ")]
        return found
    examples = []
    for line in text.splitlines():
        if match := re.match(r" +\$ (.*)", line):
            found.append(("console", match[1]))
        elif ">>> " in line and not examples:
            examples.append(("doctest", page))
    return found + examples


def main():
    """Run all of it, print each line with its exit code, and end with 1 if one of them failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one effect for each diagnosis")
    parser.add_argument("--pages", nargs="+", default=PAGES)
    parser.add_argument(
        "--folder",
        type=Path,
        help="where to work, default a temporary folder; a wheel and an environment that are there are taken",
    )
    arguments = parser.parse_args()
    print(f"sources {sources()}{', one effect for each diagnosis' if arguments.quick else ''}", flush=True)
    folder = arguments.folder or Path(tempfile.mkdtemp(prefix="new-user-"))
    folder.mkdir(parents=True, exist_ok=True)
    wheel = built(folder / "dist")
    python = fresh_environment(folder / "env")
    environment = {
        **{key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "SKAT_DATA_HOME")},
        "PATH": f"{python.parent}{os.pathsep}{os.environ['PATH']}",
        "OMP_NUM_THREADS": "1",
        "MPLBACKEND": "agg",
        "COLUMNS": "200",
    }
    failed = 0
    for page in arguments.pages:
        print(f"{page}", flush=True)
        place = folder / Path(page).stem
        place.mkdir()  # anew: nothing that an earlier run wrote is to help this one
        ready = False
        for kind, text in lines_of(page):
            if kind == "console" and text.startswith(NOT_FOR_A_WHEEL):
                print(f"   -      {text}   (for a checkout or a shell)", flush=True)
                continue
            # Before the first thing that reads them: the files that the reader has.
            if not ready and "pip install" not in text and "demo" not in text:
                at_hand(place, python, environment, wheel, page)
                ready = True
            began = time.monotonic()
            done = subprocess.run(
                command(kind, text, python, wheel, arguments.quick),
                cwd=place,
                env=environment | ({"SCIPY_ARRAY_API": "1"} if "gpu_array" in page else {}),
                capture_output=True,
                text=True,
            )
            failed += done.returncode != 0
            shown = text if kind == "console" else f"({kind}) {text.strip().splitlines()[0]}"
            print(f"   rc {done.returncode:<3} {time.monotonic() - began:5.0f} s  {shown}", flush=True)
            if done.returncode:
                print((done.stdout + done.stderr)[-1500:], flush=True)
        for name in ("better.xml", "report.html"):
            if (place / name).exists():
                said = opened(place / name, python)
                failed += said is None
                print(f"   {'FAILS' if said is None else 'opens'} {name}: {said}", flush=True)
    print("all of it runs" if not failed else f"{failed} failed")
    sys.exit(bool(failed))


def sources():
    """Return a hash of what is tried: the package, the pages, and the files that are put at hand."""
    pages = [ROOT / page for page in [*PAGES, "docs/arm_logs.py", "docs/readme.py"]]
    files = sorted(file for file in (ROOT / "skat").rglob("*") if file.is_file() and file.suffix != ".pyc")
    digest = hashlib.sha256()
    for file in [*files, *pages]:
        digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def built(folder):
    """Return the wheel of this checkout; one that is there already is taken."""
    for wheel in folder.glob("skat-*.whl"):
        print(f"took {wheel.name}", flush=True)
        return wheel
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT],
        check=True,
    )
    (wheel,) = folder.glob("skat-*.whl")
    print(f"built {wheel.name}", flush=True)
    return wheel


def fresh_environment(folder):
    """Return the interpreter of an environment in which nothing is installed."""
    if not folder.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def command(kind, text, python, wheel, quick):
    """Return the arguments of the process that does what the page says."""
    if kind == "python":
        return [python, "-c", text]
    if kind == "doctest":
        page = (ROOT / text).read_text("utf-8")
        for ours, theirs in FOR_THE_READER.items():
            page = page.replace(ours, theirs)
        code = (
            "import doctest, sys\n"
            f"test = doctest.DocTestParser().get_doctest({page!r}, {{}}, {text!r}, {text!r}, 0)\n"
            "runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)\n"
            "runner.run(test)\n"
            "sys.exit(bool(runner.summarize().failed))"
        )
        return [python, "-c", code]
    words = shlex.split(text, comments=True)
    if words[:2] == ["pip", "install"]:
        return [python, "-m", "pip", "install", "--quiet", *(from_wheel(word, wheel) for word in words[2:])]
    if words[0] == "python":
        return [python, *words[1:]]
    if words[0] == "skat" and words[1] in ("diagnose", "preflight") and quick:
        words += ["--effect", "dry_friction[elbow]"]
    return [str(python.parent / words[0]), *words[1:]]


def from_wheel(requirement, wheel):
    """Return the wheel where a page says skat, with the extras that it names."""
    match = re.fullmatch(r"skat(\[.*\])?", requirement)
    return f"skat{match[1] or ''} @ {wheel.as_uri()}" if match else requirement


def at_hand(place, python, environment, wheel, page):
    """Put the robot and the logs of a page into its folder."""
    if "tutorial" in page:  # It offers the script for download, and runs it.
        shutil.copy(ROOT / "docs" / "readme.py", place)
        return
    kinds = "('csv',)" if page == "README.md" else "('csv', 'bag', 'mcap', 'lerobot', 'positions', 'months')"
    if page != "README.md":
        extras = from_wheel("skat[ros,parquet]", wheel)
        subprocess.run([python, "-m", "pip", "install", "--quiet", extras], check=True, env=environment)
    code = f"import runpy; runpy.run_path({str(ROOT / 'docs' / 'arm_logs.py')!r})['write']('.', {kinds})"
    subprocess.run([python, "-c", code], cwd=place, env=environment, check=True)


class Title(html.parser.HTMLParser):
    """Collects the words of a page's first heading, and counts its pictures."""

    def __init__(self):
        super().__init__()
        self.inside, self.heading, self.pictures = False, "", 0

    def handle_starttag(self, tag, attrs):
        """Note a heading that begins, and a picture."""
        self.inside |= tag == "h1" and not self.heading
        self.pictures += tag in ("svg", "img")

    def handle_endtag(self, tag):
        """Note a heading that ends."""
        self.inside &= tag != "h1"

    def handle_data(self, data):
        """Keep what stands in the heading."""
        self.heading += data if self.inside else ""


def opened(path, python):
    """Return what a model or a report shows to one who has no skat, or None."""
    if path.suffix == ".xml":
        code = (
            "import sys; sys.modules['skat'] = None\n"
            "import mujoco; m = mujoco.MjModel.from_xml_path('better.xml'); mujoco.mj_step(m, mujoco.MjData(m))\n"
            "print(f'time step {m.opt.timestep:g} s, friction of its joints', *m.dof_frictionloss.round(4), 'N m')"
        )
        done = subprocess.run([python, "-I", "-c", code], cwd=path.parent, capture_output=True, text=True)
        return done.stdout.strip() if done.returncode == 0 else None
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    text = path.read_text("utf-8")
    if browser:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
        text = subprocess.run([browser, *options, path.as_uri()], capture_output=True, text=True).stdout
    title = Title()
    title.feed(text)
    if not title.heading.strip() or not title.pictures:
        return None
    who = Path(browser).name if browser else "a parser; no browser is here"
    return f"{' '.join(title.heading.split())}; {title.pictures} pictures; opened by {who}"


if __name__ == "__main__":
    main()
