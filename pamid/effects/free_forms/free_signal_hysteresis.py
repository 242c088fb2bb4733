"""Hysteresis of no known law, of a signal.

What it is
    A command or a reading that lags behind every turn of what it should follow by a share of the
    way since then, at any speed: a bank of plays whose widths go from an eightieth of the range to
    four fifths of it, each with a separate share.
What it looks like
    A loop between what goes in and what comes out, of the same width slow and fast; small loops
    close.
Looks like it
    A lag, whose loop closes at low speed; a curve that is not straight, the same up and down.
Equation
    value -= sum_j c_j stop(value, r_j) / r_j, r = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6) half
    the range
References
    Kuhnen (2003), European J. Control 9(4), 407-418; Brokate, Sprekels (1996), Hysteresis and
    Phase Transitions, Springer.
"""

from pamid.model.free_form import FreeLoop, elements, half_width


class FreeSignalHysteresis(FreeLoop):
    """A bank of plays on the value."""

    family = "hysteresis"
    kinds = ("command", "reading")
    parameters = (*elements(0.1, 0.3), half_width("value"))
    look_alikes = ("signal-hysteresis", "play")
    along = "value"
    shown = "change of the value"
    known_by = "a value that remembers where it turned"
