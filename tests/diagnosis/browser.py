"""Chromium without a window, for tests that look at a page as a reader does.

Needs Chromium and its driver (Debian's ``chromium`` and ``chromium-driver``) and selenium; axe-core is looked for where
``npm install axe-core`` puts it, or where AXE_CORE says that axe.min.js is. To look at
a report oneself: ``python -m tests.diagnosis.browser report.html FOLDER`` writes pictures of it and a PDF.
"""

import base64
import os
import shutil
import sys
from pathlib import Path

import pytest

FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--hide-scrollbars",
]
AXE = Path(__file__).parents[2] / "node_modules" / "axe-core" / "axe.min.js"


def browser():
    """Return a driver, or skip the test."""
    selenium = pytest.importorskip("selenium", reason="needs selenium: pip install selenium")
    chromium = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chromium-browser")
    driver = shutil.which("chromedriver")
    if not (chromium and driver):
        pytest.skip("needs Chromium and its driver: apt install chromium chromium-driver")
    from selenium import webdriver

    assert selenium
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))


def axe_script():
    """Return the text of axe-core, or skip the test."""
    path = Path(os.environ.get("AXE_CORE", AXE))
    if not path.is_file():
        pytest.skip("needs axe-core: npm install axe-core, or AXE_CORE=path/of/axe.min.js")
    return path.read_text(encoding="utf-8")


class Reader:
    """Who looks at a page, at a width and in light, dark or print."""

    def __init__(self, driver):
        self.driver = driver

    def look(self, path, *, width=1280, scheme="light", media="screen"):
        """Open a file."""
        self.driver.get_log("browser")
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500},
        )
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})
        self.driver.get(path.as_uri())
        return self

    def ask(self, script, *arguments):
        """Return what a script says."""
        return self.driver.execute_script(script, *arguments)

    def messages(self):
        """Return what the console has said since the page was opened."""
        return self.driver.get_log("browser")

    def printed(self):
        """Return the page as PDF."""
        answer = self.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": False})
        return base64.b64decode(answer["data"])

    def photographed(self):
        """Return the whole page as PNG."""
        answer = self.driver.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True})
        return base64.b64decode(answer["data"])


def photograph(page, folder):
    """Write pictures of a page for desk and phone, light and dark, and as it is printed."""
    folder.mkdir(parents=True, exist_ok=True)
    driver = browser()
    try:
        for width in (1280, 390):
            for scheme in ("light", "dark"):
                reader = Reader(driver).look(page.resolve(), width=width, scheme=scheme)
                (folder / f"{page.stem}-{width}-{scheme}.png").write_bytes(reader.photographed())
        (folder / f"{page.stem}.pdf").write_bytes(Reader(driver).look(page.resolve()).printed())
    finally:
        driver.quit()


if __name__ == "__main__":
    photograph(*map(Path, sys.argv[1:]))
