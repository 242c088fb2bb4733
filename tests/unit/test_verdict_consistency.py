"""Thousands of drawn results: verdict, sentence, terminal and page never contradict each other."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pamid_cli.diagnose import diagnosis_text
from synthetic_run import diagnosis_json
from test_decision import FRICTION, GAP, LEAK, PLAIN

import pamid.diagnosis.consistency as consistency
import pamid.diagnosis.decision as decision
from pamid.diagnosis.consistency import inconsistencies, unnamed
from pamid.diagnosis.decision import Decision, Share, Weighed, decide
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.verdict_grounds import LeftOver
from pamid.diagnosis.verdict_words import MEASURE_MAP, RECORD_MORE, sentence, weight_of
from pamid.report import captions
from pamid.report.answers import how_far_answer, left_answer, where_answer, which_answer
from pamid.report.channel_errors import errors_of
from pamid.report.load import RunData
from pamid.schemas.diagnosis_file import CAUSED, DiagnosisFile, Remainder
from pamid.schemas.model import read

MANY = settings(max_examples=1000, deadline=None, suppress_health_check=list(HealthCheck))
PORTS = ("joint", "muscle", "valve", "sensor")
EFFECTS = (
    ("coulomb-friction", "friction"),
    ("lugre-friction", "friction"),
    ("leak", "leak"),
    ("gravity", "gravity"),
    ("dead-time", "command-timing"),
)
CHANCES = st.floats(0.0, 1.0)


@pytest.fixture(autouse=True, scope="module")
def _plain() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        for module in (decision, consistency):
            patch.setattr(module, "calibration", lambda: PLAIN)
        yield


@st.composite
def shares(draw: st.DrawFn) -> Share:
    low, share, high = sorted(draw(st.floats(-1.0, 1.0)) for _ in range(3))
    return Share(share, low, high)


@st.composite
def misfits(draw: st.DrawFn) -> LeftOver:
    return LeftOver(
        floors=draw(st.floats(1.0, 1e5)),
        of_signal=draw(st.floats(1e-4, 3.0)),
        missing=10.0 ** draw(st.floats(-4.0, 5.0)),
        next_sure=draw(st.floats(-3.0, 30.0)),
        next_removes=draw(st.floats(-1.0, 1.0)),
        network=draw(st.floats(-1.0, 1.0)),
    )


@st.composite
def weighed_effects(draw: st.DrawFn, most: int = 3) -> list[Weighed]:
    chosen = draw(st.lists(st.sampled_from(EFFECTS), min_size=1, max_size=most, unique=True))
    return [
        Weighed(
            effect,
            family,
            draw(CHANCES),
            draw(shares()),
            draw(st.sampled_from([(), (), (), ("size",)])),
            draw(st.floats(0.0, 1.0)),
            bent=draw(st.sampled_from([None, None, 0.01, 0.2])),
            sure=draw(st.floats(-3.0, 12.0)),
        )
        for effect, family in chosen
    ]


@st.composite
def questions(draw: st.DrawFn) -> tuple[LeftOver, LeftOver, list[Weighed], list[Weighed], str]:
    """What `decide` is asked: ties are sought among single effects, and hold the first."""
    every = draw(weighed_effects())
    tied = draw(st.booleans())
    return (
        draw(misfits()),
        draw(misfits()),
        every[:1] if tied else every,
        every if tied else [],
        draw(st.sampled_from(["", "", "", "units", "empty"])),
    )


@MANY
@given(questions())
def test_a_decision_never_contradicts_what_it_was_asked(
    asked: tuple[LeftOver, LeftOver, list[Weighed], list[Weighed], str],
) -> None:
    before, after, weighed, tied, doubt = asked
    found = decide(before, after, weighed, tied, tied, doubt=doubt)
    known = {w.effect: w for w in (*weighed, *tied)}
    named = [known[effect] for effect in found.named]
    assert (found.verdict in CAUSED) == bool(named)
    assert not any(w.objections() for w in named)
    assert (found.verdict == "cannot-tell") == bool(found.why)
    assert not doubt or found.verdict == "cannot-tell"
    yes = PLAIN.lines["cause"].yes
    if found.verdict == "ambiguous":
        assert len({w.family for w in named}) > 1 and sum(w.probability for w in named) >= yes
    elif named:
        assert all(w.probability >= yes for w in named)
        assert (found.verdict == "partly-explained") == found.remainder_real
    elif not doubt:
        silent = found.verdict == "no-structural-gap"
        beyond = before.floors >= 1.0 + DEFAULT.gap_margin
        # none is said neither of a gap that is real nor of one that is more probable than not
        assert silent == (not found.gap_real and not (beyond and found.gap > DEFAULT.open_gap))
        assert (found.why == "open") == (not silent and not found.gap_real)
    assert all(0.0 <= p <= 1.0 for p in (found.gap, found.remainder, found.known))
    assert 0.0 < found.gap_p_value <= 1.0 and 0.0 < found.remainder_p_value <= 1.0


@MANY
@given(questions(), st.integers(0, 2), CHANCES)
def test_what_becomes_more_probable_is_not_dropped_for_it(
    asked: tuple[LeftOver, LeftOver, list[Weighed], list[Weighed], str], which: int, more: float
) -> None:
    before, after, weighed, tied, doubt = asked
    one = (tied or weighed)[which % len(tied or weighed)]

    def raised(these: Sequence[Weighed]) -> list[Weighed]:
        return [
            replace(w, probability=max(w.probability, more)) if w.effect == one.effect else w
            for w in these
        ]

    first = decide(before, after, weighed, tied, doubt=doubt)
    then = decide(before, after, raised(weighed), raised(tied), doubt=doubt)
    assert one.effect in then.named or one.effect not in first.named
    beside = decide(before, after, raised(weighed), [], raised(tied), doubt=doubt)
    assert (
        one.effect in beside.named
        or one.effect not in decide(before, after, weighed, [], tied, doubt=doubt).named
    )
    assert then.known >= first.known or first.verdict != then.verdict


# ---- files -------------------------------------------------------------------------------------


def file_of(
    found: Decision,
    weighed: list[Weighed],
    tied: list[Weighed],
    rest: Share,
    ports: dict[str, str],
    left: LeftOver = GAP,
) -> DiagnosisFile:
    """diagnosis.json as `pamid.diagnosis.verdict` makes it of a decision, whose figures stand where
    they do in the ground of a run."""
    made = diagnosis_json("explained")
    known = {w.effect: w for w in (*weighed, *tied)}
    entering = {
        p: max((w.here for e, w in known.items() if ports[e] == p), default=0.01) for p in PORTS
    }
    where = sorted(entering.items(), key=lambda one: -one[1])
    causes = [known[effect] for effect in found.named]
    port = ports[causes[0].effect] if causes else where[0][0]
    real = bool(causes and found.remainder_real) or found.verdict == "unknown-effect"
    unsure = found.verdict == "cannot-tell" and found.gap_real
    probable, plain = decision.counts_from(left, DEFAULT)

    def signature(w: Weighed) -> dict[str, float]:
        return {"bounds": float(len(w.at_bound)), "sure": w.sure, "lead_sure": w.sure}

    made |= {
        "verdict": found.verdict,
        "remark": "Check the columns." if found.why in ("units", "empty") else "",
        "causes": [
            {
                "effect": w.effect,
                "family": w.family,
                "port": ports[w.effect],
                "parameters": {},
                "probability": w.probability,
                "removes": vars(w.removes),
                "share": 1.0 / len(causes),
            }
            for w in causes
        ],
        "members": [
            {
                "effect": w.effect,
                "family": w.family,
                "port": ports[w.effect],
                "probability": w.probability,
                "removes": vars(w.removes),
                "bent": w.bent,
                "signature": signature(w),
            }
            for w in weighed
        ],
        "remainder": {
            **(vars(rest) if causes else {"share": 1.0, "low": 1.0, "high": 1.0}),
            "floors": left.floors,
            "probable_from": probable,
            "evidence": left.missing,
            "plain_from": plain,
            "probability": found.remainder if causes else found.gap,
            "p_value": found.remainder_p_value if causes else found.gap_p_value,
            "real": real or unsure,
            "port": ("muscle" if causes else port) if real else "",
            "formula": "0.3 sign(velocity)" if real else "",
        },
        "unknown": diagnosis_json("unknown-effect")["unknown"]
        if found.verdict == "unknown-effect"
        else None,
        "look_alikes": [],
        "next_experiment": None,
        "transfer": [],
        "ranking": [
            {
                "effect": w.effect,
                "family": w.family,
                "port": ports[w.effect],
                "probability": w.probability,
                "held_out": {},
                "shrinkage": w.removes.share,
                "low": w.removes.low,
                "high": w.removes.high,
                "signature": signature(w),
            }
            for w in known.values()
        ],
    }
    made["where"] |= {
        "port": port,
        "ports": [{"port": p, "share": s} for p, s in where],
        "indistinguishable": [],
    }
    bare = read(DiagnosisFile, made)
    return bare.model_copy(update={"sentence": sentence(bare)})


@st.composite
def files(draw: st.DrawFn) -> DiagnosisFile:
    before, after, weighed, tied, doubt = draw(questions())
    ports = {effect: draw(st.sampled_from(PORTS)) for effect, _ in EFFECTS}
    here = {port: draw(st.floats(0.0, 1.0)) for port in PORTS}
    weighed, tied = (
        [replace(w, here=here[ports[w.effect]]) for w in these] for these in (weighed, tied)
    )
    found = decide(before, after, weighed, tied, doubt=doubt)
    left = after if found.named else before
    return file_of(found, weighed, tied, draw(shares()), ports, left)


def page_of(found: DiagnosisFile) -> tuple[str, str]:
    """Headline, and all that stands in the answers and titles of the page."""
    run = RunData((), None, found, None, None, None, None)
    rows = errors_of(run)
    answers = [
        where_answer(run),
        which_answer(run),
        how_far_answer(run, rows),
        left_answer(run),
    ]
    head = captions.verdict_sentence(run, rows)
    texts = [head, captions.budget_title(rows, found), captions.ranking_title(found)]
    texts += [t for a in answers if a is not None for t in (a.lead, *a.details, *a.points)]
    return plainly(head), plainly("\n".join(texts))


def plainly(text: str) -> str:
    return text.replace("\u00a0", " ").replace("\u2212", "-")


def figures_in(text: str) -> list[str]:
    return re.findall(r"-?\d+(?:\.\d+)?", text)


@MANY
@given(files())
def test_terminal_page_and_file_say_the_same(found: DiagnosisFile) -> None:
    assert inconsistencies(found) == []
    headline, page = page_of(found)
    nulls = dict.fromkeys(("remainder", "unknown", "next_experiment"))
    terminal = diagnosis_text(nulls | found.as_json(), Path("run"))
    assert terminal.startswith(found.sentence)
    assert figures_in(headline) == figures_in(found.sentence), "the same figures in the same order"
    if not found.causes:
        for text in (found.sentence, page, terminal):
            assert not re.search(r"with (the )?cause", text)
    for cause in found.causes:
        assert cause.effect in found.sentence and cause.effect in terminal
        assert captions.effect_label(cause.effect).lower() in headline.lower()
    if found.verdict == "cannot-tell" and not found.remark:
        advice = MEASURE_MAP if MEASURE_MAP in found.sentence else RECORD_MORE
        assert advice in found.sentence and advice in headline
    rest = found.remainder
    assert rest is not None and rest.probability is not None and rest.evidence is not None
    if not found.remark:
        assert_one_decision(rest, terminal)
    if found.causes and rest is not None and rest.share is not None:
        share = plainly(captions.percent(rest.share))
        assert f"Left over: {share} of the gap" in page
        assert f"Left      {share} of the gap" in terminal
        assert (f"{share} remain" in headline) == rest.real


def assert_one_decision(rest: Remainder, terminal: str) -> None:
    """Whether what is left is more than tolerances, and the figure that decided it: a probability
    beside "more" reached its line, or stands as what the errors alone would have said; one beside
    "not told" did not, and where that is not plain the line is said."""
    assert rest.probability is not None and rest.probable_from is not None
    assert rest.evidence is not None and rest.plain_from is not None
    said = weight_of(rest)
    assert said in terminal
    if rest.real:
        assert said.startswith("more than noise")
        alone = "the errors alone would not have" in said
        assert alone == (rest.probability < rest.probable_from)
        assert not alone or rest.evidence >= rest.plain_from
        assert ("that it is more" in said) != alone
    elif "that it is more" in said:
        assert rest.probability < rest.probable_from
        line = f"it counts from {rest.probable_from:.2f} on" in said
        assert line == (rest.probability >= DEFAULT.plainly_not)
    else:
        assert "of the noise floor" in said
        assert rest.floors is not None and rest.floors < 1.0 + DEFAULT.gap_margin


def changed(verdict: str, **changes: Any) -> DiagnosisFile:
    return read(DiagnosisFile, diagnosis_json(verdict) | changes)


def of(verdict: str, key: str, **changes: Any) -> dict[str, Any]:
    """One part of the file of a verdict, with other entries; of a list the first."""
    part = diagnosis_json(verdict)[key]
    whole = [part[0] | changes, *part[1:]] if isinstance(part, list) else part | changes
    return {key: whole}


LINES = {"probable_from": 0.78, "plain_from": 2.0, "floors": 4.0}
FRICTION_MEMBER = {"effect": "coulomb-friction", "signature": {"bounds": 1.0}}
SHARES_ELSEWHERE = [{"port": "valve", "share": 0.995}, {"port": "joint", "share": 0.005}]


@pytest.mark.parametrize(
    ("verdict", "changes", "told"),
    [
        ("explained", {"causes": []}, "the verdict is explained, with 0 causes"),
        ("unknown-effect", of("explained", "causes"), "unknown-effect, with 1 causes"),
        (
            "explained",
            {"causes": diagnosis_json("explained")["causes"] * 2},
            "a cause stands twice",
        ),
        ("ambiguous", of("explained", "causes"), "of one family"),
        ("partly-explained", of("explained", "remainder"), "nothing real remains"),
        ("partly-explained", {"remainder": None}, "nothing real remains"),
        ("explained", of("partly-explained", "remainder"), "what remains is real"),
        ("explained", of("explained", "remainder", port="joint"), "enters at a port"),
        ("explained", of("unknown-effect", "unknown"), "an unknown effect is described"),
        ("explained", of("explained", "remainder", **LINES, probability=0.9), "a line is reached"),
        ("explained", of("explained", "remainder", **LINES, evidence=3.0), "a line is reached"),
        (
            "partly-explained",
            of("partly-explained", "remainder", **LINES, probability=0.7),
            "neither line is reached",
        ),
        ("explained", {"remark": "Check the columns."}, "a remark says"),
        ("explained", of("explained", "causes", probability=None), "without a probability"),
        ("explained", of("explained", "causes", removes=None), "not told what it removes"),
        (
            "explained",
            of("explained", "causes", removes={"share": 0.3, "low": 0.0, "high": 0.6}),
            "goes through zero",
        ),
        (
            "explained",
            of("explained", "causes", removes={"share": 0.01, "low": 0.005, "high": 0.02}),
            "removes next to nothing",
        ),
        ("explained", {"members": [FRICTION_MEMBER]}, "ended at a bound"),
        (
            "explained",
            of("explained", "where", ports=SHARES_ELSEWHERE, indistinguishable=[])
            | of("explained", "causes", removes={"share": 0.45, "low": 0.3, "high": 0.6}),
            "next to nothing of the gap enters at its port",
        ),
        ("explained", of("explained", "where", port="valve"), "where no cause acts"),
        ("unknown-effect", of("explained", "where", port="valve"), "enters elsewhere"),
        ("unknown-effect", of("unknown-effect", "remainder", port="valve"), "instead of joint"),
        ("explained", {"sentence": "Leak explains the gap."}, "does not name coulomb-friction"),
        ("cannot-tell", {"sentence": "Better with the cause."}, "speaks of a cause"),
        (
            "cannot-tell",
            {"sentence": "Nothing can be said.", "next_experiment": None},
            "what to check or to record",
        ),
    ],
)
def test_a_contradiction_is_found(verdict: str, changes: dict[str, Any], told: str) -> None:
    assert inconsistencies(changed(verdict)) == []
    assert any(told in one for one in inconsistencies(changed(verdict, **changes)))


def test_what_is_probable_and_not_named_has_something_against_it() -> None:
    likely = of("explained", "members", probability=0.97)["members"]
    bare = changed("unknown-effect", members=likely)
    assert any("is probable (P 0.97) and nothing here" in one for one in inconsistencies(bare))
    pressed = changed("unknown-effect", members=[likely[0] | {"signature": {"bounds": 1.0}}])
    ((member, why),) = unnamed(pressed)
    assert (member.effect, why) == (
        "coulomb-friction",
        ["a parameter ended at a bound that physics did not set"],
    )
    assert inconsistencies(pressed) == []
    assert unnamed(changed("explained")) == []
    # found beside what is named, and not in the model: the same is asked of it
    beside = changed("explained", dropped=[likely[0] | {"effect": "leak"}])
    assert any("leak is probable (P 0.97) and nothing" in one for one in inconsistencies(beside))
    doubtful = changed("explained", dropped=[likely[0] | {"effect": "leak", "probability": 0.4}])
    assert inconsistencies(doubtful) == []


def test_a_port_that_the_sensors_cannot_tell_carries_the_share_of_both() -> None:
    ports = of("explained", "where", ports=SHARES_ELSEWHERE, indistinguishable=[["valve", "joint"]])
    assert inconsistencies(changed("explained", **ports)) == []


def test_probabilities_are_never_certain_and_small_shares_are_not_nothing() -> None:
    sure = replace(FRICTION, probability=1.0, removes=Share(0.9931, 0.9, 0.999))
    slight = replace(LEAK, probability=0.5)
    found = file_of(
        decide(GAP, GAP, [sure, slight]),
        [sure, slight],
        [],
        Share(0.0069, 0.001, 0.1),
        {"coulomb-friction": "joint", "leak": "valve"},
    )
    assert found.sentence == (
        "coulomb-friction at the joint port (P > 0.99) and leak at the valve port (P 0.50) explain "
        "99.3 % of the gap; 0.6 % remain, at the muscle port."
    )


def test_a_gap_that_stays_open_is_told_with_its_chance_and_the_nearest_effect() -> None:
    nearest = {
        "effect": "coulomb-friction",
        "family": "friction",
        "port": "joint",
        "probability": 0.43,
        "removes": {"share": 0.45, "low": -0.46, "high": 0.64},
    }
    rest = {"share": 1.0, "floors": 21.0, "probability": 0.72, "real": False, "port": ""}
    found = changed("cannot-tell", remark="", members=[nearest], remainder=rest)
    assert sentence(found) == (
        "These recordings leave open whether anything is missing (P 0.72): what is left is 21 "
        "times the noise floor in the worst channel. The nearest is coulomb-friction at the joint "
        f"port (P 0.43), 45 % of it (95 % interval -46 to 64 %). {RECORD_MORE}"
    )
    weak = changed("cannot-tell", remark="", members=[], remainder=rest)
    assert "nearest" not in sentence(weak) and RECORD_MORE in sentence(weak)
