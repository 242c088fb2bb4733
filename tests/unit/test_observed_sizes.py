"""How large values at the ports were: from states estimated on the recordings, from free runs only
where these say nothing."""

from typing import Any

import numpy as np
import one_cart
from effect_bench import carts, inputs_of

from pamid.estimation import observed_sizes as module
from pamid.estimation.observed_sizes import observed_sizes
from pamid.recording.recording import recording_of
from pamid.simulation.data_split import split_recordings


def test_a_free_run_is_made_only_where_something_is_missing(monkeypatch):
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
