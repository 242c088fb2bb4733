"""Text of data as it may be shown: names out of a file cannot steer a terminal or hide in a line.

Escape sequences move the cursor, rename windows and hide lines; marks of direction and of no width
let a name pass for another. All are written out (`\\u001b`, `\\u202e`), in a form that JSON and
TOML read as the very same text.
"""

from __future__ import annotations

import json
import re

#: control characters but tab and line end, soft hyphen, marks of direction, of no width and of
#: tags, half characters
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\ufff9-\ufffb\ud800-\udfff\U000e0000-\U000e007f]"
)


def printable(text: str) -> str:
    """The text with everything written out that a terminal obeys or hides."""

    def written_out(match: re.Match[str]) -> str:
        code = ord(match[0])
        return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"

    return _UNSEEN.sub(written_out, text)


def printable_json(text: str) -> str:
    """The same of JSON: it stays JSON, and holds the same."""
    return _UNSEEN.sub(lambda match: json.dumps(match[0])[1:-1], text)
