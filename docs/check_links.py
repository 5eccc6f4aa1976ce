"""Look each link within built pages up, files and places in them: ``python docs/check_links.py docs/_build/html``."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """The places of a page that can be linked to, and what it links to."""

    def __init__(self, path: Path):
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element can be called and what it links to."""
        for name, value in attrs:
            if value and name in ("id", "name"):
                self.places.add(value)
            elif value and name in ("href", "src"):
                self.links.append(value)


def broken(root: Path) -> tuple[int, list[str]]:
    """Return the number of links within the pages below a folder, and those that lead nowhere."""
    # The theme's own files are templates.
    paths = [path for path in root.resolve().rglob("*.html") if "_static" not in path.parts]
    pages = {path: Page(path) for path in paths}
    number, lost = 0, []
    for path, page in pages.items():
        # In listings of sources Sphinx has one name for the place of all that a module holds.
        for link in page.links if "_modules" not in path.parts else ():
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            number += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            place = unquote(parts.fragment)
            if not target.exists() or (place and target in pages and place not in pages[target].places):
                lost.append(f"{path.name}: {link}")
    return number, lost


if __name__ == "__main__":
    number, lost = broken(Path(sys.argv[1]))
    print(f"{number} links within the pages, {len(lost)} of them lead nowhere")
    sys.exit("\n".join(lost) if lost or not number else 0)
