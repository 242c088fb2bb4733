"""How large values at the ports were: from states estimated on the recordings, from free runs only
where these say nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import one_cart
import pytest
from effect_bench import carts, inputs_of

from pamid.estimation import observed_sizes as module
from pamid.estimation.observed_sizes import observed_sizes, unsized
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.recording.recording import recording_of
from pamid.simulation.data_split import split_recordings
from pamid.symbolic.vocabulary import Number


def test_a_free_run_is_made_only_where_something_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[Any] = []
    plain = module.port_sizes
    monkeypatch.setattr(module, "port_sizes", lambda *given: made.append(given) or plain(*given))
    evidence = split_recordings(one_cart.cart(), [one_cart.recorded()], [])
    sizes = observed_sizes(evidence)
    assert not made and sizes["guide", "velocity"] > 0.0
    # a current that rests is sized by nothing that was estimated
    rig = carts()
    sent = inputs_of(rig, 1500)
    columns = {"push": sent[:, 0], "current": np.zeros(1500)}
    columns |= {"first": 0.01 * np.sin(0.05 * np.arange(1500)), "second": np.zeros(1500)}
    recording = recording_of(rig.period_s * np.arange(1500), columns, name="carts")
    sizes = observed_sizes(split_recordings(rig, [recording], []))
    assert len(made) == 1 and ("guide", "current") not in sizes


def test_a_rig_without_ports_knows_how_long_it_was_recorded() -> None:
    """What drifts over a recording is sized by that, with and without probes."""

    class Line(Rig):
        """A gain."""

        inputs = {"sent": ""}
        outputs = {"read": ""}
        ports = {"wire": Port("command", "", (), size={"value": 1.0})}
        parameters = (Parameter("gain", 1.0, 0.1, 10.0, source="bench"),)
        period_s = 0.01

        def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {}

        def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {"read": p.gain * port("wire", u.sent)}

    sent = np.repeat(np.random.default_rng(0).standard_normal(40), 25)
    recording = recording_of(0.01 * np.arange(1000), {"sent": sent, "read": 2.0 * sent}, name="l")
    sizes = observed_sizes(split_recordings(Line(), [recording], []))
    assert sizes["", "time"] == pytest.approx(7.0)  # seven tenths are fitted


@pytest.mark.parametrize("unit", [1.0, 2.0**-10])
def test_what_is_shut_is_sized_by_what_would_move_the_outputs(unit: float) -> None:
    """A vessel whose valve is shut: nothing passes in the model, and its pressure falls."""

    class Vessel(Rig):
        """A vessel, its gauge beside it."""

        inputs = {}
        outputs = {"pressure": ""}
        ports = {"air": Port("rate", "", ("stored",)), "spare": Port("command", "")}
        states = (State("held", "", 5.0 * unit),)
        parameters = (Parameter("bulk", 1.0, 0.5, 2.0, source="bench"),)
        period_s = 0.1

        def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {"held": port("air", 0.0 * p.bulk, stored=x.held) + 0.0 * port("spare", 0.0)}

        def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {"pressure": x.held}

    time = 0.1 * np.arange(900)
    noise = 0.002 * np.random.default_rng(0).standard_normal(900)
    read = unit * (5.0 * np.exp(-time / 60.0) + noise)
    evidence = split_recordings(Vessel(), [recording_of(time, {"pressure": read}, name="v")], [])
    sizes = observed_sizes(evidence)
    # the pressure falls by 5/60 a second at first, by 5/60 exp(-1) after a minute
    assert 0.03 * unit < sizes["air", "value"] < 0.1 * unit
    assert unsized(evidence, sizes) == ["spare"]  # what moves no output is of no size
