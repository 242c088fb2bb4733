"""Draws notebooks/pictures/motor-page.png anew, the top of the page of a run as the README shows
it: `python tests/support/readme_picture.py RUN` (needs chromium).

RUN is that of the README's first example, after `pamid report RUN`.
"""

import sys
import tempfile
from pathlib import Path

from browser import browser
from PIL import Image

PICTURE = Path(__file__).resolve().parents[2] / "notebooks" / "pictures" / "motor-page.png"
WIDTH, HEIGHT = 1280, 680
COLOURS = 128


def main() -> None:
    shown = Path(sys.argv[1]) / "report.html"
    if not shown.is_file():
        sys.exit(f"there is no {shown}: pamid report {sys.argv[1]}")
    with browser() as opened, tempfile.TemporaryDirectory() as folder:
        page = opened.page(width=WIDTH, height=HEIGHT)
        page.open(shown)
        page.settle()
        seen = Path(folder) / "seen.png"
        page.screenshot(seen, whole=False)
        with Image.open(seen) as picture:
            picture.convert("RGB").quantize(COLOURS).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
