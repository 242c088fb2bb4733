"""What `pamid fit` prints of its parameters, and spans of time in words."""

import pytest

from pamid.base.share_words import minutes_text


@pytest.mark.parametrize(
    ("minutes", "text"), [(8.0, "8 min"), (1.0, "1 min"), (0.67, "40 s"), (0.0017, "0.1 s")]
)
def test_short_experiments_are_told_in_seconds(minutes, text):
    assert minutes_text(minutes) == text
