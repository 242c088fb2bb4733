"""Length of the windows by the first Gauss-Newton step."""

from __future__ import annotations

from dataclasses import replace

import pytest
from small_cart import cart_evidence, record_cart

from pamid.estimation import window_length
from pamid.estimation.grey_box import model_with
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import SHORTEST, Problem, free_parameters
from pamid.estimation.window_length import first_step_helps, with_linear_windows
from pamid.simulation.data_split import DataSplit


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> DataSplit:
    return cart_evidence(record_cart(tmp_path_factory.mktemp("cart")))


def test_a_step_of_a_damped_machine_lowers_its_misfit(cart: DataSplit) -> None:
    assembly = model_with(cart, (), observed_sizes(cart))
    tracks = cart.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    assert first_step_helps(problem)
    assert with_linear_windows(cart).timescale_s == cart.timescale_s


@pytest.mark.parametrize("longest", [1.0, 0.6, 0.3])
def test_windows_are_halved_until_a_step_lowers_the_misfit(
    longest: float, cart: DataSplit, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = replace(cart, timescale_s=8.0 * cart.timescale_s)

    def helps(problem: Problem) -> bool:
        return problem.tracks[0].timescale_s <= longest * slow.timescale_s

    monkeypatch.setattr(window_length, "first_step_helps", helps)
    share = with_linear_windows(slow).timescale_s / slow.timescale_s
    assert share == {1.0: 1.0, 0.6: 0.5, 0.3: 0.25}[longest]


def test_windows_stay_where_no_length_helps(
    cart: DataSplit, monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths: list[int] = []

    def never(problem: Problem) -> bool:
        lengths.append(problem.window)
        return False

    monkeypatch.setattr(window_length, "first_step_helps", never)
    assert with_linear_windows(cart) is cart
    assert min(lengths) >= 0.7 * SHORTEST
