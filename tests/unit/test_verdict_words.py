"""What a verdict says in words of where the gap enters."""

from __future__ import annotations

import pytest

from pamid.diagnosis.verdict_words import AS_IN_FILE, _entrance
from pamid.schemas.diagnosis_file import PortShare, Where

SHARES = (PortShare(port="sensor", share=0.48), PortShare(port="block", share=0.26))


@pytest.mark.parametrize(
    ("together", "said"),
    [
        (
            (("block", "sensor"),),
            " It enters at the block port, or at sensor: these sensors do not tell them apart.",
        ),
        ((), " It enters at the block port."),
        ((("sensor", "heater"),), " It enters at the block port."),
    ],
)
def test_a_port_that_takes_as_much_is_named_where_nothing_tells_them_apart(
    together: tuple[tuple[str, ...], ...], said: str
) -> None:
    where = Where(port="block", ports=SHARES, indistinguishable=together)
    assert _entrance(where, AS_IN_FILE) == said


def test_a_port_with_less_of_the_gap_is_not_named() -> None:
    where = Where(port="sensor", ports=SHARES, indistinguishable=(("block", "sensor"),))
    assert _entrance(where, AS_IN_FILE) == " It enters at the sensor port."
