"""Length of the windows by the first Gauss-Newton step."""

from dataclasses import replace

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart

from pamid.estimation import window_length
from pamid.estimation.grey_box import model_with
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import SHORTEST, Problem, free_parameters
from pamid.estimation.window_length import cost_ratio_of_first_step, with_linear_windows
from pamid.simulation.data_split import DataSplit


@pytest.fixture(scope="module")
def cart(tmp_path_factory) -> DataSplit:
    return cart_evidence(record_cart(tmp_path_factory.mktemp("cart")))


def test_a_step_of_a_damped_machine_lowers_its_misfit(cart):
    assembly = model_with(cart, (), observed_sizes(cart))
    tracks = cart.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    assert cost_ratio_of_first_step(problem) < 1.0
    assert with_linear_windows(cart).timescale_s == cart.timescale_s


@pytest.mark.parametrize("longest", [1.0, 0.6, 0.3])
def test_windows_are_halved_until_a_step_lowers_the_misfit(longest, cart, monkeypatch):
    slow = replace(cart, timescale_s=8.0 * cart.timescale_s)

    def ratio(problem):
        return 0.5 if problem.tracks[0].timescale_s <= longest * slow.timescale_s else 2.0

    monkeypatch.setattr(window_length, "cost_ratio_of_first_step", ratio)
    share = with_linear_windows(slow).timescale_s / slow.timescale_s
    assert share == {1.0: 1.0, 0.6: 0.5, 0.3: 0.25}[longest]


def test_the_longest_windows_of_about_the_lowest_ratio_are_taken_where_no_step_lowers_the_misfit(
    cart, monkeypatch
):
    slow = replace(cart, timescale_s=8.0 * cart.timescale_s)
    ratios: list[float] = []
    windows: list[int] = []

    def ratio(problem):
        windows.append(problem.window)
        return ratios[len(windows) - 1]

    monkeypatch.setattr(window_length, "cost_ratio_of_first_step", ratio)
    ratios[:] = [9.0, 3.0, np.inf, 2.0, *[np.inf] * 9]
    assert with_linear_windows(slow).timescale_s == slow.timescale_s / 2.0
    assert min(windows) >= 0.7 * SHORTEST
    windows.clear()
    ratios[:] = [np.inf] * 13
    assert with_linear_windows(slow).timescale_s == slow.timescale_s
