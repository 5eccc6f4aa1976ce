"""``python -m skat`` is the command line."""

from skat.cli import app

if __name__ == "__main__":
    app(prog_name="skat")
