"""How large what passes at the ports of a MuJoCo model is: by the run, not by the file."""

from pathlib import Path

import numpy as np
import pytest
from mechanisms import ONE, TWO

from pamid.model.assembly import Assembly
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.simulation.free_runs import port_sizes

pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")


def rig(text: str, folder: Path) -> CompiledMechanism:
    path = folder / "model.xml"
    path.write_text(text)
    return CompiledMechanism(read_mechanism(path))


def test_a_size_is_stated_only_where_nothing_drives_a_joint(tmp_path):
    passive = TWO.replace('<motor name="m2" joint="elbow" gear="1.5" ctrlrange="-1 1"/>', "")
    assert passive != TWO
    assert not any(port.size for port in rig(TWO, tmp_path).ports.values())
    stated = {name for name, port in rig(passive, tmp_path).ports.items() if port.size}
    assert stated == {"elbow"}


def test_sizes_are_those_of_what_was_sent(tmp_path):
    a = Assembly(rig(ONE, tmp_path))
    u = np.repeat([0.2, -0.2, 0.1, -0.2, 0.2], 100)[:, None]  # of a range of -1 .. 1
    sizes = port_sizes(a, [(u, a.values(), 0.004)])
    assert sizes["motor_command", "value"] == pytest.approx(0.2)
    # gear 2, less the damping on the way; the joint's inertia times 10 rad/s2 would be 0.46
    assert 0.3 < sizes["shoulder", "value"] < 0.6
