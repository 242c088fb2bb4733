"""The horizon of a motor: parameter errors that add up over a long run are no gap."""

from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame

from pamid.api.given import evidence_of
from pamid.base.metrics import seen_mean
from pamid.base.parallel.jobs import WorkerPool
from pamid.diagnosis.budget import Budget, gap_budget
from pamid.diagnosis.settings import DEFAULT


@pytest.fixture(scope="module")
def budget(tmp_path_factory) -> Budget:
    """Of a motor that is its rig to the noise, recorded under its controller for 12 s from the
    second row on."""
    folder = tmp_path_factory.mktemp("motor")
    sent, log, cut = (str(folder / name) for name in ("sent.csv", "log.csv", "cut.csv"))
    excite = "pamid generate-aprbs --rig dc-motor --duration 30 --seed 1"
    simulate = "pamid simulate --rig dc-motor --noise default --seed 2"
    for words in ([excite, "--output", sent], [simulate, "--excitation", sent, "--output", log]):
        assert frame.run([*words[0].split()[1:], *words[1:]]) == 0
    head, _, *rows = Path(log).read_text(encoding="utf-8").splitlines()
    Path(cut).write_text("\n".join([head, *rows[:5997]]) + "\n", encoding="utf-8")
    Path(cut).with_suffix(".toml").write_bytes(Path(log).with_suffix(".toml").read_bytes())
    evidence = evidence_of([cut], "dc-motor", [], check=False, warn=lambda text: None).evidence
    return gap_budget(
        evidence, seed=0, pool=WorkerPool(), progress=lambda text: None, settings=DEFAULT
    )


def test_a_run_over_which_parameter_errors_add_up_is_not_scored(budget):
    assert budget.evidence.per_run == 1
    refitted, floor = seen_mean(budget.baseline.absolutes), seen_mean(budget.floor)
    assert np.all(refitted < 1.2 * floor)
