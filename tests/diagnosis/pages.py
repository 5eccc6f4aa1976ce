"""What tests read from a page."""

import re
from html.parser import HTMLParser

import numpy as np

VOID = {"meta", "img", "br", "link", "input", "hr", "wbr"}
BREAK = "\N{ZERO WIDTH SPACE}"


class Page(HTMLParser):
    """The parts of a page; tags that do not match raise.

    Attributes
    ----------
    tags, sources, ids : list of str
        Elements, what they refer to, and what they are called.
    text : str
        All that is said, without style and script.
    plots : list of dict
        Of each plot its labels "up" and "across", its summary, and the roles of its lines.
    """

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.texts, self.sources, self.ids, self.plots = [], [], [], [], [], []
        self.feed(html)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append((tag, given.get("class", "")))
        if tag == "wbr":
            self.texts.append(BREAK)
        self.sources += [given[name] for name in ("src", "href") if name in given]
        self.ids += [given["id"]] if "id" in given else []
        if given.get("class") == "plot":
            self.plots.append({"roles": [], "up": "", "across": ""})
        elif tag == "svg" and "aria-label" in given:
            self.plots[-1]["summary"] = given["aria-label"]
        elif tag == "path" and given["class"] != "grid" and ("div", "plot") in self.open:
            self.plots[-1]["roles"].append(given["class"])

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop()[0] == tag, f"</{tag}> closes something else"

    def handle_data(self, data):
        if self.open and self.open[-1][0] not in ("style", "script"):
            self.texts.append(data)
            if self.open[-1][1] in ("up", "across") and self.plots:
                self.plots[-1][self.open[-1][1]] += data

    @property
    def text(self):
        joined = " ".join(self.texts).replace("\N{NO-BREAK SPACE}", " ")
        return re.sub(r"\s+", " ", re.sub(rf"\s*{BREAK}\s*", "", joined))


def blank_frames(simulator, poses, ghosts, *, size):
    """Return black pictures in place of `skat.replay.frames`, which draws in a process of its own."""
    return [np.zeros((size[1], size[0], 3), dtype=np.uint8) for _ in poses]
