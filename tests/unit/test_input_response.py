"""Channels that do not show the machine."""

from types import SimpleNamespace

import numpy as np
import pytest

from pamid.diagnosis import input_response
from pamid.estimation.lagged_linear import LaggedResponse


@pytest.mark.parametrize(("explained", "silent"), [(0.5, ("second",)), (0.95, ())])
def test_a_regression_that_misses_explained_channels_names_no_other(explained, silent, monkeypatch):
    # the model explains the first channel; explained: error ratio of the regression there
    monkeypatch.setattr(input_response, "following_channels", lambda *_: np.zeros(2, bool))
    budget = SimpleNamespace(
        model=SimpleNamespace(evidence=SimpleNamespace(channels=("first", "second"))),
        settings=SimpleNamespace(naive_near_floor=3.0),
        floor=np.full((4, 2), 0.001),
    )
    model = SimpleNamespace(absolutes=np.full((4, 2), 0.1))
    response = LaggedResponse(forward=np.array([explained, 0.95]), backwards=np.ones(2))
    named = input_response.silent_channels(budget, model, np.array([True, False]), response)
    assert tuple(named) == silent
