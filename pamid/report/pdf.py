"""The PDF of a page, printed by an installed browser (Chromium, Chrome or Edge).

The page has a style for paper; a second layout engine would have to repeat it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from pamid.base.errors import FileError

#: the last line of every PDF written here, behind its end, where readers ignore it: by this a PDF
#: of ours is known from somebody's file
PDF_MARK = b"\n% pamid.report/1\n"
_ON_PATH = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
)
_ELSEWHERE = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
_PRINT_OPTIONS = (
    "--headless",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--no-pdf-header-footer",
)
_PATIENCE_S = 300.0  # a page of all pictures takes a few seconds


def installed_browser() -> str | None:
    """Path of a browser that prints pages without a window; None if there is none."""
    on_path = (shutil.which(name) for name in _ON_PATH)
    elsewhere = (path for path in _ELSEWHERE if os.access(path, os.X_OK))
    return next(filter(None, (*on_path, *elsewhere)), None)


def printed(html: bytes) -> bytes:
    """The page `html` as a PDF on A4. FileError if no browser is installed, or it fails."""
    browser = installed_browser()
    if browser is None:
        raise FileError(
            "No browser for printing the page is installed.",
            "Install Chromium, Chrome or Edge, or open the page in any browser and print it there.",
            code="no-browser",
        )
    with tempfile.TemporaryDirectory(prefix="pamid-") as folder:
        page, pdf = Path(folder) / "report.html", Path(folder) / "report.pdf"
        page.write_bytes(html)
        command = [browser, *_PRINT_OPTIONS, f"--user-data-dir={folder}/profile"]
        if os.name == "posix" and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium refuses to start for root with it
        command += [f"--print-to-pdf={pdf}", page.as_uri()]
        try:
            ended = subprocess.run(command, capture_output=True, timeout=_PATIENCE_S, check=False)
            complaint = ended.stderr.decode(errors="replace").strip()[-300:]
        except (OSError, subprocess.TimeoutExpired) as error:
            complaint = str(error)
        if not pdf.exists():
            raise FileError(
                f"{browser} did not print the page: {complaint or 'no reason given'}.",
                "Open the page in a browser and print it there.",
                code="not-printed",
            )
        return pdf.read_bytes() + PDF_MARK
