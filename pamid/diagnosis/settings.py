"""Every threshold, share, count and time of a diagnosis, with its unit, its meaning and what speaks
for its value.

Logistic weights are not among them: they were fitted to calibration cases and stand in
calibration.json. They were fitted under the settings below; under others the probabilities are no
longer calibrated.

    found = diagnose(evidence, catalogue, settings=Settings(refits=12))
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from pamid.base.errors import UsageError, nearest
from pamid.diagnosis.setting_kinds import COST, JUDGEMENT, SHOWN_ONLY, require_like, setting


@dataclass(frozen=True)
class Settings:
    """See `described` for unit, meaning and evidence of each. UsageError for a value of another
    kind than the default, or one that is negative or not finite."""

    # ---- comparison (comparison, answer, selection)
    material_share: float = setting(
        0.15, "share of the gap", "a cause removes at least this much, next to the others"
    )
    standard_errors: float = setting(
        3.0, "standard errors", "a cause removes it with at least this certainty, paired"
    )
    tie_errors: float = setting(
        2.0, "standard errors", "families within this much of the best tie with it"
    )
    tie_margin: float = setting(
        0.03, "share of the gap", "... and so do those within this share of it"
    )
    tied_most: int = setting(2, "families", "that are named as alternatives, at most")
    material_rest: float = setting(
        0.2,
        "share of the gap",
        "a larger remainder is stated, and further effects are sought in it",
    )
    floor_margin: float = setting(
        0.10, "share of the noise floor", "a model nearer to the floor than this is at it"
    )

    # ---- is there a gap? (budget, decision, input_response, misfit_beyond_range)
    naive_margin: float = setting(
        0.10,
        "share of the error",
        "a model has to be better than a guess without a model by this much, or explains nothing",
        "an equivalence margin as gap_margin; tests/integration/test_nonsense.py holds what it has "
        "to refuse and to let pass",
    )
    naive_near_floor: float = setting(
        2.0, "noise floors", "a model this near to the floor need not beat a line (same tests)"
    )
    naive_plain: float = setting(
        0.5, "share of the error", "a model with less is better, however few windows there are"
    )
    input_shifts: int = setting(
        4,
        "count",
        "time shifts of the inputs whose predictions stand for those without inputs",
        "benchmarks/nonsense.py: 116 recordings without a machine",
    )
    own_terms: float = setting(
        0.05, "share of what an effect adds", "the rig's own terms leave no more: it is one of them"
    )

    # ---- horizon (budget)
    horizons: tuple[int, ...] = setting(
        (8, 4, 2), "windows", "that one run covers, where it cannot cover a whole recording", COST
    )
    horizon_floor: float = setting(
        1.5, "ratio", "by which the noise of an estimated start may raise the noise floor"
    )
    horizon_gain: float = setting(
        1.35,
        "ratio of errors in noise floors",
        "a longer horizon is used where it shows this much more of the gap",
        "docs/measured/comparison.md: where it shows less, near ties are lost",
    )

    # ---- long recordings (tournament)
    fitted_most: float = setting(
        500.0,
        "correlation times",
        "recordings that models are fitted to, in all: of longer ones evenly spread stretches",
        COST,
    )
    held_out_most: float = setting(
        215.0, "correlation times", "... and that they are compared on, as 30 % is to 70 %", COST
    )

    # ---- screening (screening, starting_hints, tournament)
    port_reach: float = setting(
        0.3,
        "share of the largest latent evidence",
        "of many candidates those whose ports have less are not screened",
        COST,
    )
    held_background_from: int = setting(
        60,
        "candidates",
        "above it they are screened with the background held, and by port_reach",
        "a step with the background held is several times as cheap; the one-dof rig has 33 "
        "candidates, the two-link rig 121",
    )
    screen_length: float = setting(
        16.0, "correlation times", "fitted recordings that screening looks at, in all", COST
    )
    screen_beside: float = setting(
        10.0, "correlation times", "... beside effects that are already found", COST
    )
    screen_windows: int = setting(3, "windows", "of every recording, at least", COST)
    trace_start: float = setting(
        0.1,
        "typical size",
        "an effect is also started as a trace of itself: next to the baseline the cost leads down "
        "wherever the effect helps",
    )
    probe_steps: int = setting(2, "Gauss-Newton steps", "from each starting point", COST)
    screen_steps: int = setting(4, "Gauss-Newton steps", "from the best of them", COST)
    refreshed_from: float = setting(
        3.0, "nats", "gained or promised, from which a candidate's Jacobian is computed anew", COST
    )
    scanned_samples: int = setting(4000, "samples", "on which all values are tried", COST)
    scanned_checked: int = setting(24, "values", "best on a part, tried on all fitted data", COST)
    scanned_beside: float = setting(0.1, "share of the cost", "that pulses take off, to scan", COST)
    scanned_starts: int = setting(2, "values", "of a scanned parameter, the best ones", COST)
    sheet_advantage: float = setting(
        1.05,
        "cost ratio",
        "a baseline worse than this against the data sheet's parameters is screened from these",
    )
    refits: int = setting(
        8, "candidates", "refitted by their gain, beside the best of every further family", COST
    )
    refits_least: int = setting(6, "candidates", "refitted in any case", COST)
    refit_share: float = setting(
        0.1, "share of the largest gain", "further candidates with less are not refitted", COST
    )
    family_share: float = setting(
        0.2, "share of the largest gain", "the best of a further family with less is not refitted"
    )
    family_nats: float = setting(1.0, "nats", "... nor one that gains less than this")
    slowest_line: float = setting(
        0.3,
        "per correlation time",
        "a line of the gap's spectrum below it is drift, and starts no vibration",
    )
    spectrum_smooth: int = setting(
        401, "lines", "over which the spectrum is averaged; a line is what stands out of that", COST
    )
    spectrum_apart: int = setting(60, "lines", "nearer ones are of the same vibration", COST)
    spectrum_lines: int = setting(3, "count", "lines of the spectrum offered to an effect", COST)
    spatial_bins: int = setting(
        4096, "count", "parts of the range travelled, for the spectrum over the position", COST
    )
    spatial_least: float = setting(
        2.0, "periods", "within the range travelled, for a line over it to be told from a trend"
    )

    # ---- refit and ranking (contender, search)
    refit_iterations: int = setting(15, "Gauss-Newton steps", "of a refit at most", COST)
    carried_on_iterations: int = setting(
        60,
        "Gauss-Newton steps",
        "more of a refit that had used up its steps, before nothing known is said to explain a gap",
        COST,
    )
    refit_tolerance: float = setting(2e-2, "share of the cost", "less gained ends a refit", COST)
    widenings: int = setting(
        2,
        "count",
        "times that a range which is a guess is widened where a fit ends at its end",
        "two of four: sixteen times a guess that was made from a typical magnitude",
    )
    wider: float = setting(4.0, "ratio", "... by this")
    pressed: float = setting(
        3.0,
        "nats per prior spread",
        "what a fit would still gain beyond a bound for its end there to say that the form is "
        "another",
    )
    mirrored_share: float = setting(
        0.2, "share of the error", "removed with the other sign, for a port's sign to be doubted"
    )
    mirrored_most: int = setting(3, "candidates", "fitted with the opposite sign", COST)
    few_windows: int = setting(
        12, "windows", "with fewer held out it is said that they are few", SHOWN_ONLY
    )
    far_off: float = setting(
        2.9,
        "tolerances",
        "a background term or parameter farther off is named, with what would bring it back",
        "the term's range ends at three tolerances (REACH in pamid/model/background.py)",
    )
    far_off_eased: float = setting(0.5, "tolerances", "that an effect takes off it", SHOWN_ONLY)
    far_off_alike: int = setting(3, "effects", "named beside it at most", SHOWN_ONLY)
    reweight_rounds: int = setting(
        2, "count", "refits with the weights of the model's own residuals, at most", COST
    )
    reweight_factor: float = setting(1.2, "ratio of weights", "growth that ends them", COST)
    stepping_rounds: int = setting(3, "count", "halvings of the winner's steps at most", COST)
    alike_share: float = setting(
        0.25,
        "share",
        "two models are alike where their predictions differ by less than this share of what "
        "either changes against the baseline",
    )
    alike_noise: float = setting(0.5, "standard deviations of the noise", "... or less than this")

    # ---- further effects (forward_selection)
    effects_most: int = setting(
        3,
        "count",
        "effects of a cause at most",
        "the blind trial plants two at most (pamid/trial/cases.py)",
    )
    refits_beside: int = setting(4, "candidates", "refitted beside a first effect", COST)
    subsets: int = setting(6, "combinations", "at most, of effects, refitted jointly", COST)
    subset_rows: int = setting(8000, "residuals", "thinned to which subsets are compared", COST)

    # ---- where (port_evidence)
    port_alike: float = setting(
        0.98,
        "share of the larger evidence",
        "ports nearer than this cannot be told apart by these recordings",
    )
    port_players: int = setting(
        2, "ports", "classes whose joint evidence is computed for Shapley shares", COST
    )
    ports_all: int = setting(
        20,
        "ports",
        "of more only those that stand out with the parameters held are looked at closely",
        COST,
    )
    port_outstanding: float = setting(
        0.15, "share of the largest evidence with the parameters held", "... which is this", COST
    )
    # ---- the smoother of latent values (smoother, smoothed_trajectory)
    latent_sizes: tuple[float, ...] = setting(
        (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
        "sizes of the port's value",
        "standard deviations of a latent value that are tried, the smallest first",
        "half a decade apart up to the whole value; " + JUDGEMENT,
    )
    latent_times: tuple[float, ...] = setting(
        (0.16, 1.6),
        "correlation times",
        "time constants of a latent value that are tried, the first one with every size",
        "the length of a slice and of the shortest window (pamid/simulation/replay.py)",
    )
    latent_reach: float = setting(
        5.0, "ratio", "sizes nearer than this to the likeliest are tried with every time", COST
    )
    latent_slice: float = setting(
        0.16,
        "correlation times",
        "slices over which a latent value is constant",
        "33 samples of a joint that is sampled every 3 ms; " + COST,
    )
    latent_slice_samples: int = setting(4, "samples", "of a slice at least", COST)
    latent_stiffness: float = setting(
        1e-4,
        "standard deviations of the state",
        "what a state other than a latent value may jump by between two slices",
        "a numerical stand-in for zero: small against any noise, large enough for the blocks to be "
        "inverted in double precision",
    )
    latent_window_jump: float = setting(
        1e3,
        "standard deviations of the state",
        "... at most where a window begins, there being another estimated start",
        "a numerical stand-in for no bound at all",
    )
    smoother_steps: int = setting(20, "Gauss-Newton steps", "of a smoothing at most", COST)
    smoother_tolerance: float = setting(
        1e-3, "share of the cost", "a step that gains less ends a smoothing", COST
    )
    smoother_trusted: float = setting(
        0.1,
        "share of the cost",
        "most that a step which was not taken may promise to gain and be believed",
        "a quadratic model of the cost is trusted near its point alone (trust regions: Nocedal and "
        "Wright (2006), Numerical Optimization, chapter 4)",
    )
    smoother_damping: float = setting(
        1e-10,
        "diagonal scaled to one",
        "least damping of a step, and the one of the evidence",
        "what keeps a singular block solvable in double precision, without weight in the result",
    )
    smoother_damping_falls: float = setting(
        0.01, "ratio", "by which the damping falls behind a step that was taken", COST
    )
    smoother_damping_rises: float = setting(
        30.0, "ratio", "by which the damping rises behind a step that failed", COST
    )
    smoother_damping_raised: float = setting(
        1e-4, "diagonal scaled to one", "... to this at least", COST
    )

    # ---- regimes, bands and windows (localise)
    regime_bins: int = setting(12, "count", "quantiles of a signal between which regimes lie")
    regime_gain: float = setting(
        0.15, "share", "a regime holds this much more of the gap than of the time", SHOWN_ONLY
    )
    regime_bound: float = setting(
        0.01,
        "share of the gap",
        "what a bound has to bring, unless zero or the range's end",
        SHOWN_ONLY,
    )
    regime_order: float = setting(
        0.002, "share of the gap", "what a signal has to bring beyond the plainer one", SHOWN_ONLY
    )
    regime_overlap: float = setting(
        0.5, "share of the samples", "regimes that share more are one", SHOWN_ONLY
    )
    regimes_most: int = setting(4, "count", "regimes stated", SHOWN_ONLY)
    smoothed: float = setting(
        0.025,
        "correlation times",
        "half of what measured signals are smoothed over before they state a regime",
        SHOWN_ONLY,
    )
    spectrum_segment: float = setting(
        13.0, "correlation times", "a segment of the spectrum that states the band", SHOWN_ONLY
    )
    still: float = setting(
        0.02, "usual speed (95th percentile)", "a slower motion reverses nothing", SHOWN_ONLY
    )
    band_share: float = setting(
        0.8, "share of the gap's power", "inside the frequency band stated, its middle", SHOWN_ONLY
    )
    worst_windows: int = setting(3, "count", "windows stated", SHOWN_ONLY)

    # ---- an effect that no file of the catalogue explains (unknown)
    formula_bags: int = setting(24, "count", "bootstrap samples of the sparse regression", COST)
    formula_threshold: float = setting(
        0.08,
        "standard deviations of the target",
        "smaller coefficients are set to zero (sequentially thresholded least squares, Brunton, "
        "Proctor and Kutz 2016)",
        SHOWN_ONLY,
    )
    formula_slices: int = setting(40, "slices", "fewer are not described", SHOWN_ONLY)
    formula_explains: float = setting(
        0.5, "share of the variance", "what is described worse depends on the past", SHOWN_ONLY
    )
    parity_factor: float = setting(
        3.0, "ratio", "by which the odd part exceeds the even one, or the reverse", SHOWN_ONLY
    )
    formula_ridge: float = setting(1e-3, "share of the rows", "ridge of the regression", SHOWN_ONLY)
    formula_sign: float = setting(
        0.05, "usual speed (95th percentile)", "of the sign: tanh(v / this)", SHOWN_ONLY
    )
    parity_bins: int = setting(
        8, "count", "ranges of size in which both directions are compared", SHOWN_ONLY
    )
    form_tail: float = setting(0.5, "per cent of the samples", "beyond either end of its curve")
    rough_share: float = setting(
        0.05, "share of what passes", "by which ordinary maps are rough at most", SHOWN_ONLY
    )
    missing_rows: int = setting(4000, "rows", "of missing.csv at most", SHOWN_ONLY)

    # ---- how far, and what next (transfer, next_experiment)
    amplitude_factor: float = setting(
        1.5, "ratio", "spreads of an output that differ by more are other amplitudes", SHOWN_ONLY
    )
    experiment_models: int = setting(3, "models", "to be set apart at most", COST)
    experiment_tail: float = setting(
        2.0, "per cent of the samples", "left out at either end of what was recorded, for spikes"
    )
    experiment_range: float = setting(
        0.05, "recorded span", "how far a rig without a loop may leave where it was recorded"
    )
    experiment_ways: tuple[tuple[float, int], ...] = setting(
        ((1.0, 1), (1.0, 2), (1.0, 4), (0.5, 1), (0.5, 2), (0.25, 1)),
        "share of the recorded range, times faster",
        "in which an experiment without a loop is tried",
        COST,
    )
    experiment_washouts: tuple[float, ...] = setting(
        (0.3, 0.1, 0.03), "share of the length", "whose mean is taken off one that leaves it", COST
    )
    experiment_old: float = setting(
        16.0, "correlation times", "of every old recording that a re-adjustment looks at", COST
    )
    experiment_steps: int = setting(3, "Gauss-Newton steps", "of either fit of one", COST)
    experiment_tolerance: float = setting(2e-2, "share of the cost", "a lesser step ends it", COST)
    experiment_visible: float = setting(
        1.0, "standard deviations of the noise", "less is no clear separation, and said", SHOWN_ONLY
    )

    def __post_init__(self) -> None:
        for f in fields(self):
            require_like(f.name, getattr(self, f.name), f.default)


def settings_from(given: Mapping[str, Any]) -> Settings:
    """The defaults with these replaced. UsageError for an unknown name, with the nearest, or a
    value that `Settings` refuses."""
    names = [f.name for f in fields(Settings)]
    for name in given:
        if name not in names:
            raise UsageError(
                f"a diagnosis has no setting {name!r}",
                nearest(name, names) or f"settings: {', '.join(names)}",
            )
    return Settings(**given)


def described() -> list[dict[str, Any]]:
    """name, default, unit, meaning and evidence of every setting."""
    return [{"name": f.name, "default": f.default, **f.metadata} for f in fields(Settings)]


DEFAULT = Settings()
