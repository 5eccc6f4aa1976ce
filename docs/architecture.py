"""Draw how the parts of skat depend on each other, from the imports in its files.

``python docs/architecture.py`` writes ``docs/_static/architecture.svg``, and with ``--check`` fails if that file is
stale. A part is a folder or a module beside ``skat/__init__.py``. Each stands above all that it imports; an arrow
that other arrows imply is left out.
"""

import ast
import sys
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "skat"
PICTURE = ROOT / "docs" / "_static" / "architecture.svg"
WIDTH, BOX_HEIGHT, GAP, LETTER = 960, 34, 46, 7.4


def imports_of_parts(package=PACKAGE):
    """Return the parts that each part imports, by name, those within functions included."""
    parts = {
        path.stem: sorted(path.rglob("*.py")) if path.is_dir() else [path]
        for path in sorted(package.iterdir())
        if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    parts = {name: files for name, files in parts.items() if name not in ("__init__", "__main__")}
    found = {}
    for name, files in parts.items():
        modules = {module for file in files for module in _imported(ast.parse(file.read_text("utf-8")))}
        heads = {module.split(".")[1] for module in modules if module.startswith("skat.")}
        found[name] = (heads & set(parts)) - {name}
    return found


def layers(imports):
    """Return the parts in rows, the lowest first: each above all that it imports.

    Raises
    ------
    ValueError
        If parts import each other in a circle.
    """
    left, rows, placed = dict(imports), [], set()
    while left:
        row = sorted(name for name, needed in left.items() if needed <= placed)
        if not row:
            raise ValueError(f"these parts import each other in a circle: {', '.join(sorted(left))}")
        rows.append(row)
        placed |= set(row)
        left = {name: needed for name, needed in left.items() if name not in placed}
    return rows


def needed_arrows(imports):
    """Return the pairs (part, imported part) that no longer way through other parts implies."""

    def reached(name):
        return {far for near in imports[name] for far in {near} | reached(near)}

    return sorted(
        (name, near)
        for name, nears in imports.items()
        for near in nears
        if not any(near in reached(other) for other in nears - {near})
    )


def drawing(imports):
    """Return the picture as SVG."""
    rows = _wrapped(layers(imports))
    height = len(rows) * (BOX_HEIGHT + GAP) + 20
    boxes = {}
    for level, row in enumerate(rows):
        widths = [LETTER * len(name) + 26 for name in row]
        x = (WIDTH - sum(widths) - 16 * (len(row) - 1)) / 2
        for name, width in zip(row, widths):
            boxes[name] = (x, height - 10 - BOX_HEIGHT - level * (BOX_HEIGHT + GAP), width)
            x += width + 16
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" '
        'font-family="sans-serif" font-size="13">',
        f"<title>Parts of skat; an arrow points from a part to one that it imports</title>"
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#666"/></marker></defs>',
    ]
    for name, near in needed_arrows(imports):
        (x, top, width), (to_x, to_top, to_width) = boxes[name], boxes[near]
        start, end = (x + width / 2, top + BOX_HEIGHT), (to_x + to_width / 2, to_top)
        middle = (start[1] + end[1]) / 2
        lines.append(
            f'<path d="M{start[0]:.0f} {start[1]:.0f}C{start[0]:.0f} {middle:.0f} {end[0]:.0f} {middle:.0f} '
            f'{end[0]:.0f} {end[1]:.0f}" fill="none" stroke="#999" marker-end="url(#tip)"/>'
        )
    for name, (x, top, width) in boxes.items():
        kind = "#dbe9f6" if (PACKAGE / name).is_dir() else "#eee"
        lines.append(
            f'<rect x="{x:.0f}" y="{top:.0f}" width="{width:.0f}" height="{BOX_HEIGHT}" rx="5" '
            f'fill="{kind}" stroke="#557"/>'
            f'<text x="{x + width / 2:.0f}" y="{top + 21:.0f}" text-anchor="middle" fill="#111">{escape(name)}</text>'
        )
    return "\n".join([*lines, "</svg>", ""])


def _imported(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names if node.module == "skat")


def _wrapped(rows):
    """Return the rows, those too long for the picture in several; parts of one row do not import each other."""
    wrapped = []
    for row in rows:
        line, used = [], 0.0
        for name in row:
            width = LETTER * len(name) + 42
            if line and used + width > WIDTH:
                wrapped.append(line)
                line, used = [], 0.0
            line.append(name)
            used += width
        wrapped.append(line)
    return wrapped


def main():
    """Write the picture, or check it."""
    picture = drawing(imports_of_parts())
    if "--check" in sys.argv[1:]:
        if not PICTURE.exists() or PICTURE.read_text("utf-8") != picture:
            sys.exit("docs/_static/architecture.svg is stale: run python docs/architecture.py")
        return
    PICTURE.write_text(picture, "utf-8")


if __name__ == "__main__":
    main()
