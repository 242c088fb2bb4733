"""What sensors can tell apart by structure: against every subset of random systems, by hand, and a
published table."""

import random
from itertools import combinations

import pytest

from pamid.base.schemas.diagnosis_file import Sensor
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.effect import State
from pamid.model.isolability import Isolability, Structure, isolability
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.rigs.one_dof import OneDof

# ---- the decomposition --------------------


def _random(seed: int) -> Structure:
    """Up to 9 equations in up to 6 unknowns; some equations hold none."""
    r = random.Random(seed)
    unknowns = [("state", f"x{k}") for k in range(r.randint(1, 6))]
    density = r.choice([0.15, 0.3, 0.5])
    return Structure(
        tuple(
            frozenset(v for v in unknowns if r.random() < density) for _ in range(r.randint(1, 9))
        )
    )


def _surplus(system: Structure, part: tuple[int, ...]) -> int:
    return len(part) - len({v for i in part for v in system.equations[i]})


def _minimal_checks(system: Structure) -> list[set[int]]:
    """Every minimal set of more equations than unknowns, by trying all subsets from the small ones
    up."""
    found: list[set[int]] = []
    count = len(system.equations)
    for size in range(1, count + 1):
        for part in combinations(range(count), size):
            if _surplus(system, part) > 0 and not any(f <= set(part) for f in found):
                found.append(set(part))
    return found


@pytest.mark.parametrize("seed", range(150))
def test_decomposition_agrees_with_all_minimal_checks(seed):
    system = _random(seed)
    checks = _minimal_checks(system)
    count = len(system.equations)
    assert system.part == set().union(*checks)
    subsets = (part for size in range(count + 1) for part in combinations(range(count), size))
    assert system.redundancy == max(_surplus(system, part) for part in subsets)
    for j in range(count):
        # what some check sees without j
        told = {i for check in checks if j not in check for i in check}
        assert system.hidden_by(j) == system.part - told


# ---- by hand --------------------


class Cascade(Rig):
    """Two tanks in a row: pump -> tank 1 -> pipe -> tank 2 -> outlet, a gauge on each."""

    inputs = {"command": ""}
    outputs = {"level_1_m": "m", "level_2_m": "m"}
    ports = {
        "pump": Port("command"),
        "pipe": Port("flow", "m3/s"),
        "outlet": Port("flow", "m3/s", group="drain"),
        "gauge": Port("reading", "m", places=("1", "2")),
    }
    states = (State("level_1", "m"), State("level_2", "m"))
    parameters = (Parameter("area", 0.01, 0.001, 0.1, "m2", source="ruler"),)

    def rates(self, x, u, p, port):
        pipe, outlet = port("pipe", 1e-3 * x.level_1), port("outlet", 1e-3 * x.level_2)
        return {
            "level_1": (port("pump", u.command) - pipe) / p.area,
            "level_2": (pipe - outlet) / p.area,
        }

    def measure(self, x, u, p, port):
        return {
            "level_1_m": port("gauge", x.level_1, place="1"),
            "level_2_m": port("gauge", x.level_2, place="2"),
        }


def test_two_tanks_with_the_lower_gauge_have_one_check():
    """Five cuts and states are settled from command and outlet on; the reading of level 2 is one
    equation too many."""
    found = isolability(Cascade(), ("level_2_m",))
    assert found.redundancy == 1
    assert found.places == (("pump", "pipe", "outlet", "gauge_2"),)
    assert found.groups == (("pump", "pipe", "drain", "gauge"),)
    assert found.unseen == () and found.unseen_places == ()


def test_what_lies_downstream_of_the_only_gauge_is_unseen():
    found = isolability(Cascade(), ("level_1_m",))
    assert found.redundancy == 1
    assert found.places == (("pump", "pipe", "gauge_1"),)
    assert found.unseen == ("drain",) and found.unseen_places == ("outlet",)
    assert found.sensors[0] == Sensor(sensor="level_2_m", splits=(("pump", "pipe", "gauge"),))


# ---- the joint --------------------

ANGLE = ("angle_deg",)
PRESSURES = ("pressure_1_kpa", "pressure_2_kpa")
FORCES = ("force_1_n", "force_2_n")
FLOWS = ("flow_1", "flow_2")
TORQUE = ("torque_nm",)


class Tapped(OneDof):
    """The joint with a flow meter at each valve and the torque measured, none of which the rig
    itself offers."""

    name = "tapped"
    outputs = {**OneDof.outputs, "flow_1": "m3/s", "flow_2": "m3/s", "torque_nm": "N m"}

    def measure(self, x, u, p, port):
        passed: dict[tuple[str, str], Expr] = {}

        def tap(name, value, place="", **signals):
            passed[name, place] = port(name, value, place=place, **signals)
            return passed[name, place]

        out = super().measure(x, u, p, tap)
        self.rates(x, u, p, tap)
        return {
            **out,
            "flow_1": passed["valve", "1"],
            "flow_2": passed["valve", "2"],
            "torque_nm": passed["joint", ""],
        }


#: faults of the published table of this joint (V valve, B pressure balance, M muscle, T joint
#: torque) -> our ports. The table has none for the command, nor a second place for a fault between
#: the same two equations: our `relief` is in line with `pressure`, `chain` with `muscle`, `arm`
#: with `joint`.
THEIRS = {
    "V1": "valve_1",
    "V2": "valve_2",
    "B1": "pressure_1",
    "B2": "pressure_2",
    "M1": "muscle_1",
    "M2": "muscle_2",
    "T": "joint",
    "beta": "angle_sensor",
    "P1": "pressure_sensor_1",
    "P2": "pressure_sensor_2",
    "F1": "force_sensor_1",
    "F2": "force_sensor_2",
}
TABLE = [
    (ANGLE, 1, "V1 V2 B1 B2 M1 M2 T beta"),
    (ANGLE + PRESSURES, 3, "V1 B1, V2 B2, M1 M2 T, beta, P1, P2"),
    (ANGLE + PRESSURES + FORCES, 5, "V1 B1, V2 B2, M1, M2, T, beta, P1, P2, F1, F2"),
    (ANGLE + PRESSURES + FORCES + FLOWS, 7, "V1, V2, B1, B2, M1, M2, T, beta, P1, P2, F1, F2"),
    # theirs keeps T apart from M1 M2: there the fault lies behind the measured torque. Our `joint`
    # lies before it, and `arm` behind.
    (ANGLE + PRESSURES + TORQUE, 4, "V1 B1, V2 B2, M1 M2 T, beta, P1, P2"),
]


def _their_classes(found: Isolability) -> set[frozenset[str]]:
    """Our classes of places in the table's names, what it does not name left out."""
    named = [
        frozenset(t for t, ours in THEIRS.items() if ours in places) for places in found.places
    ]
    return {n for n in named if n}


@pytest.mark.parametrize(("outputs", "redundancy", "classes"), TABLE)
def test_published_table_of_the_joint(outputs, redundancy, classes):
    found = isolability(Tapped(), outputs)
    assert found.redundancy == redundancy and found.unseen_places == ()
    assert _their_classes(found) == {frozenset(c.split()) for c in classes.split(", ")}


def test_groups_and_sensors_of_the_joint():
    alone = isolability(OneDof(), ANGLE)
    assert alone.groups == (
        ("command", "valve", "pressure", "muscle", "structure", "joint", "sensor"),
    )
    assert {s.sensor for s in alone.sensors[:2]} == {" and ".join(PRESSURES), " and ".join(FORCES)}
    assert all(s.splits == alone.groups for s in alone.sensors[:2]) and len(alone.sensors) == 5
    # `relief` is reported as muscle, `chain` and `arm` as structure
    found = isolability(OneDof(), ANGLE + PRESSURES)
    air, mechanics = ("valve", "pressure", "muscle"), ("muscle", "structure", "joint")
    assert found.groups == (("command",), air, mechanics, ("sensor",))
    assert found.sensors[0] == Sensor(sensor=" and ".join(FORCES), splits=(mechanics,))
    assert Sensor(sensor="the value at port valve", splits=(air,)) in found.sensors


@pytest.mark.parametrize("port", ["valve", "joint"])
def test_a_direct_measurement_splits_as_the_same_sensor_in_a_rig_does(port):
    """What is promised for "the value at port X" holds for a rig that has that output."""
    before = isolability(OneDof(), ANGLE + PRESSURES + FORCES)
    after = isolability(
        Tapped(), ANGLE + PRESSURES + FORCES + {"valve": FLOWS, "joint": TORQUE}[port]
    )
    (promised,) = [s for s in before.sensors if s.sensor == f"the value at port {port}"]
    assert promised.splits == tuple(
        g for g in before.groups if not any(set(g) <= set(a) for a in after.groups)
    )
    assert promised.splits
