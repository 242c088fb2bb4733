"""Small things that several commands take: name=value pairs and noise factors."""

from __future__ import annotations

import click


def parse_known(pairs: tuple[str, ...]) -> dict[str, float]:
    """("inertia_kg_m2=0.0896", ...) as a table."""
    from pamid.base.errors import UsageError

    table = {}
    for pair in pairs:
        name, sign, value = pair.partition("=")
        try:
            table[name.strip()] = float(value)
        except ValueError:
            sign = ""
        if not sign:
            raise UsageError(
                f"{pair!r} is not NAME=VALUE with a number.", "For example inertia_kg_m2=0.0896."
            )
    return table


def noise_factor(text: str) -> float:
    """default -> 1, none -> 0, a number as it is."""
    from pamid.base.errors import UsageError

    words = {"default": 1.0, "none": 0.0}
    try:
        factor = words[text] if text in words else float(text)
    except ValueError:
        factor = -1.0
    if factor < 0.0:
        raise UsageError(f"--noise {text!r}: it takes default, none or a factor of at least 0.")
    return factor


no_check_option = click.option(
    "--no-check",
    is_flag=True,
    help="Fit recordings as they are, also where `pamid check` calls them wrong for the rig.",
)
