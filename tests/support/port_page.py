"""Writes the part of data/rigs/README.md that follows from the catalogue:
`python tests/support/port_page.py`."""

from __future__ import annotations

from pathlib import Path

from pamid.model.port_guide import page_section
from pamid.model.registry import effects

PAGE = Path(__file__).resolve().parents[2] / "data" / "rigs" / "README.md"
BEGIN = "<!-- from the catalogue: python tests/support/port_page.py -->\n"
END = "<!-- end -->\n"


def written(page: str) -> str:
    """The page with that part as the catalogue now has it."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{page_section(effects().values())}\n\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
