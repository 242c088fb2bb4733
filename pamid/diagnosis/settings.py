"""Settings of a diagnosis: thresholds of the comparison, guards, and bounds of its cost, each with
its unit, its meaning and its evidence.

Constants of a numerical method or of presentation stand at the head of the module that uses them.
Logistic weights stand in calibration.json; they were fitted under the defaults, so that under other
settings probabilities are not calibrated.

    diagnosis = pamid.diagnose("rec.csv", settings={"refits": 12})
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from pamid.base.errors import UsageError, nearest

BY_COMPARISON = (
    "docs/measured/comparison.md: chosen from 60 rules on 47 recordings; 28 causes right or in a "
    "set of two (27 with 138 settings), 1 of 6 healthy machines blamed (3)"
)
BY_TRIAL = "tried together with all others by the blind trial (docs/measured/comparison.md)"
COST_ONLY = "a bound of the cost (docs/measured/speed.md); it may only hide a candidate"


def setting(default: float, unit: str, meaning: str, evidence: str) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "evidence": evidence})


@dataclass(frozen=True)
class Settings:
    """Numbers from 0 on; counts are whole numbers from 1 on. UsageError for anything else.

    `described` returns unit, meaning and evidence of each.
    """

    # ---- comparison
    material_share: float = setting(
        0.15, "share of the gap", "least that a cause removes, next to the others", BY_COMPARISON
    )
    standard_errors: float = setting(
        3.0, "standard errors", "least certainty of what a cause removes, paired", BY_COMPARISON
    )
    tie_errors: float = setting(
        2.0, "standard errors", "families nearer than this to the best tie with it", BY_COMPARISON
    )
    tie_margin: float = setting(
        0.03,
        "share of the gap",
        "families nearer than this to the best tie with it, too",
        "docs/measured/comparison.md: two standard errors separate 19 of 38 families as near",
    )
    tied_most: int = setting(
        2, "families", "named as alternatives, at most", "a larger set is no answer to act on"
    )
    material_rest: float = setting(
        0.2, "share of the gap", "a larger remainder is reported and searched for effects", BY_TRIAL
    )
    floor_margin: float = setting(
        0.10, "share of the noise floor", "a model nearer to the floor is at the floor", BY_TRIAL
    )

    unexplained_floors: float = setting(
        10.0,
        "noise floors",
        "a model farther off that nothing explains is left open, not called complete",
        "docs/measured/comparison.md: machines with rough maps alone are left at 2 to 6",
    )

    # ---- do the recordings show this machine?
    naive_margin: float = setting(
        0.10,
        "share of the error",
        "a model has to beat a guess by this much, or explains nothing",
        "benchmarks/nonsense.py: recordings without a machine are refused, others answered",
    )
    naive_plain: float = setting(
        0.5,
        "share of the error of a guess",
        "a model with less beats it, however few the windows",
        "tests/integration/test_nonsense.py: machines with six windows that have to pass",
    )
    naive_near_floor: float = setting(
        2.0,
        "noise floors",
        "a model nearer to the floor need not beat a straight line",
        "tests/integration/test_nonsense.py: slow machines that have to pass",
    )

    # ---- guards
    own_terms: float = setting(
        0.05,
        "share of what an effect adds",
        "terms of the rig that leave no more of it duplicate it",
        "tests/unit/test_own_terms.py: duplicates leave under 0.003, other effects over 0.17",
    )
    pressed: float = setting(
        3.0,
        "nats per prior spread",
        "a parameter that would gain more beyond its bound has the wrong form",
        BY_TRIAL,
    )
    far_off: float = setting(
        2.9,
        "tolerances",
        "a parameter or background term that is farther off has left its data sheet",
        "a background term's range ends at three (REACH in pamid/model/background.py)",
    )
    port_alike: float = setting(
        0.98,
        "share of the larger evidence",
        "ports with more are not separated by these recordings",
        BY_TRIAL,
    )
    alike_share: float = setting(
        0.25,
        "share of what a model changes",
        "models whose predictions differ by less look alike",
        BY_TRIAL,
    )

    # ---- horizon
    horizon_s: float = setting(
        0.0,
        "s",
        "over which a run predicts, in whole windows (0: by the next two; inf: recordings)",
        "the time over which the model is used",
    )
    horizon_floor: float = setting(
        1.5,
        "ratio of noise floors",
        "most that the noise of an estimated start may add to a longer run",
        BY_TRIAL,
    )
    horizon_gain: float = setting(
        1.35,
        "ratio of errors in noise floors",
        "a longer horizon is used where it shows this much more of the gap",
        "docs/measured/comparison.md: the true family leads in 11 of 14 real trials, not in 8",
    )

    # ---- cost
    fitted_most: float = setting(
        500.0, "correlation times", "length of the recordings that models are fitted to", COST_ONLY
    )
    held_out_most: float = setting(
        215.0,
        "correlation times",
        "length of the recordings that models are compared on",
        COST_ONLY,
    )
    effects_most: int = setting(
        3,
        "effects",
        "in an answer, at most",
        "pamid/trial/cases.py plants two at most; " + COST_ONLY,
    )
    refits: int = setting(
        4,
        "candidates",
        "with the largest gain in screening that are refitted, whatever their families",
        "the example and seven real trials (docs/measured/comparison.md): with 8 the same answers, "
        "the example at 1.2 times the CPU",
    )
    refits_further: int = setting(
        4, "candidates", "that are refitted on top of a first effect", COST_ONLY
    )
    pair_share: float = setting(
        0.2,
        "share of the largest gain",
        "least gain with which a pair is refitted",
        COST_ONLY,
    )
    subsets: int = setting(6, "pairs or triples", "that are refitted jointly, at most", COST_ONLY)
    held_background_from: int = setting(
        60, "candidates", "above which screening holds the background", COST_ONLY
    )
    port_reach: float = setting(
        0.3,
        "share of the largest latent evidence",
        "at a port of the kind; of many candidates, those at ports with less are not screened",
        COST_ONLY,
    )
    probe_steps: int = setting(
        2, "Gauss-Newton steps", "of screening from every starting point", COST_ONLY
    )
    screen_steps: int = setting(
        4,
        "Gauss-Newton steps",
        "further ones from its best start, of twice as many candidates as are refitted",
        "16 recordings, before every family was refitted: 142 of 148 refits are those of further "
        "steps for all candidates",
    )

    def __post_init__(self) -> None:
        for f in fields(self):
            value, whole = getattr(self, f.name), isinstance(f.default, int)
            number = isinstance(value, int if whole else int | float)
            if not number or isinstance(value, bool) or not value >= (1 if whole else 0):
                takes = "a whole number from 1 on" if whole else "a number from 0 on"
                raise UsageError(f"setting {f.name!r} is {value!r}", f"It takes {takes}.")

    @property
    def changed(self) -> list[str]:
        """NAME=VALUE of every setting that is not at its default."""
        every = ((f, getattr(self, f.name)) for f in fields(self))
        return [f"{f.name}={value}" for f, value in every if value != f.default]


def settings_from(
    given: Settings | Mapping[str, Any], horizon: float | str | None = None
) -> Settings:
    """Return the defaults with these replaced.

    horizon: in s, or "whole" for whole recordings; in place of `horizon_s`. UsageError for an
    unknown name, with the nearest, or for a value that `Settings` refuses.
    """
    values = dict(vars(given) if isinstance(given, Settings) else given)
    defaults = {f.name: f.default for f in fields(Settings)}
    for name, value in values.items():
        if name not in defaults:
            raise UsageError(
                f"a diagnosis has no setting {name!r}",
                nearest(name, defaults) or f"settings: {', '.join(defaults)}",
            )
        # the command line does not distinguish 12 from 12.0
        if type(value) in (int, float) and float(value).is_integer():
            values[name] = int(value) if isinstance(defaults[name], int) else float(value)
    if horizon is not None:
        try:
            values["horizon_s"] = math.inf if horizon == "whole" else float(horizon)
        except ValueError:
            values["horizon_s"] = math.nan
        if not values["horizon_s"] > 0.0:
            raise UsageError(
                f"The horizon {horizon!r} is invalid.", 'Give seconds above 0, or "whole".'
            )
    return Settings(**values)


def described() -> list[dict[str, Any]]:
    """Return name, default, unit, meaning and evidence of every setting."""
    return [{"name": f.name, "default": f.default, **f.metadata} for f in fields(Settings)]


DEFAULT = Settings()
