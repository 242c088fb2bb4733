"""Settings of a diagnosis: few, documented, used, settable, and part of the keys of its results."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame
from small_cart import RIG, cart_evidence, others, record_cart

import pamid
import pamid.diagnosis
from pamid.base.errors import ConvergenceError, UsageError
from pamid.base.parallel.jobs import Work
from pamid.base.parallel.result_store import digest
from pamid.diagnosis import budget
from pamid.diagnosis.effect_subsets import ResponseWork
from pamid.diagnosis.screening import ScreeningBaseline
from pamid.diagnosis.search import _ScreeningWork
from pamid.diagnosis.settings import DEFAULT, Settings, described, settings_from
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.simulation.replay import WHOLE

nothing: Any = None


def test_they_are_few_and_say_what_they_are_and_what_supports_them():
    assert len(described()) <= 35
    for s in described():
        assert s["unit"] and len(s["meaning"]) > 10 and len(s["evidence"]) > 20, s["name"]


def test_an_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(UsageError, match="Did you mean 'floor_margin'"):
        settings_from({"floor_margins": 0.2})
    with pytest.raises(UsageError, match="settings: material_share, "):
        settings_from({"x": 1.0})
    assert settings_from({"floor_margin": 0.2}) == Settings(floor_margin=0.2)


@pytest.mark.parametrize(
    "given",
    [
        {"floor_margin": -0.1},
        {"floor_margin": "0.1"},
        {"floor_margin": math.nan},
        {"floor_margin": True},
        {"refits": 2.5},
        {"refits": 0},
        {"refits": math.inf},
    ],
)
def test_a_value_of_another_kind_is_refused(given):
    with pytest.raises(UsageError, match=next(iter(given))):
        settings_from(given)


def test_numbers_of_the_command_line_are_those_of_python():
    assert settings_from({"refits": 12.0, "fitted_most": 300}).changed == [
        "fitted_most=300.0",
        "refits=12",
    ]
    assert settings_from(Settings(refits=12), "2.5") == Settings(refits=12, horizon_s=2.5)
    assert settings_from({}, "whole").changed == ["horizon_s=inf"]
    for horizon in ("0", -1.0, "all", math.nan):
        with pytest.raises(UsageError, match="seconds above 0"):
            settings_from({}, horizon)


def ground(settings: Settings) -> ScreeningBaseline:
    return ScreeningBaseline(nothing, nothing, 0.0, False, settings)


@pytest.mark.parametrize(
    "work",
    [
        lambda settings: _ScreeningWork(nothing, ground(settings), {}, nothing),
        lambda settings: ResponseWork(nothing, ground(settings), nothing, nothing),
    ],
)
def test_results_of_other_settings_have_other_keys(work):
    one: Work[Any, Any] = work(DEFAULT)
    assert digest(one) != digest(work(Settings(screen_steps=DEFAULT.screen_steps + 1)))
    assert digest(one) == digest(work(replace(DEFAULT)))


# ---- horizon, and the options of command and Python --------------------------------------------


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return record_cart(tmp_path_factory.mktemp("cart"), planted=())


@pytest.fixture(scope="module")
def model(recording) -> GreyBox:
    return fit_model(cart_evidence(recording), ())


@pytest.mark.parametrize(("windows", "per_run"), [(0.1, 1), (2.2, 2), (math.inf, WHOLE)])
def test_a_stated_horizon_is_taken_in_whole_windows(model, windows, per_run):
    one_s = budget._over_horizon(model, 0, Settings(horizon_s=1e-9)).horizon_s
    found = budget._over_horizon(model, 0, Settings(horizon_s=windows * one_s))
    assert found.evidence.per_run == per_run and (found.short is None) == (per_run == 1)
    held_out_s = sum(len(r.track) * r.track.period_s for r in model.held_out)
    assert found.horizon_s == pytest.approx(min(per_run * one_s, held_out_s), rel=0.05)


def test_a_horizon_at_which_the_model_diverges_is_refused(model, monkeypatch):
    whole = budget.runs_of

    def diverging(*given):
        return tuple(replace(r, finite=False) for r in whole(*given))

    monkeypatch.setattr(budget, "runs_of", diverging)
    with pytest.raises(ConvergenceError, match="diverges within"):
        budget._over_horizon(model, 0, Settings(horizon_s=math.inf))


def test_a_run_notes_what_it_was_asked_for(recording, tmp_path, capsys):
    folder = tmp_path / "run"
    words = ["diagnose", str(recording), "--rig", RIG, *others(), "--output", str(folder), "--json"]
    given = ["--horizon", "whole", "--setting", "refits=5"]
    assert frame.run([*words, *given]) == 0
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert record["options"]["settings"] == ["horizon_s=inf", "refits=5"]
    written = json.loads(capsys.readouterr().out)
    samples = len(cart_evidence(recording).recordings[0])
    assert written["horizon_s"] == pytest.approx(0.3 * samples * 0.01, rel=0.02)
    assert frame.run([*words, *given, "--resume"]) == 0
    assert frame.run([*words, "--horizon", "whole", "--resume"]) == 3, "other settings"
    with pytest.raises(pamid.PamidError, match="Differences: options"):
        left_out = [word for word in others() if word != "--without"]
        pamid.diagnose(
            recording, RIG, without=left_out, settings={"refits": 5}, output=folder, resume=True
        )
