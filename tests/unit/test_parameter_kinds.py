"""Constructors of the common kinds of parameters, and the files that state every field instead."""

import pytest

from pamid.model.parameter import Parameter
from pamid.model.registry import effects, effects_with

#: as users write effects and rigs without the constructors
EFFECT = '''"""Friction of a seal.

What it is
    A seal.
What it looks like
    Flat tops.
Looks like it
    Coulomb friction.
Equation
    value -= level * stop(position, give) / give
References
    A paper.
"""

from pamid import Effect, Parameter
from pamid.equations import stop


class SealFriction(Effect):
    family = "friction"
    kinds = ("motion",)
    signals = ("position",)
    parameters = (
        Parameter(
            "level",
            0.03,
            low=0.0,
            high=0.5,
            spread=0.1,
            size="value",
            null=0.0,
            label="{value}",
            source="a seal",
        ),
        Parameter("give", 0.001, 0.0001, 0.02, spread=3.0, log=True, size="travel", source="seal"),
    )

    def act(self, value, at, p, z):
        return value - p.level * stop(at.position, p.give) / p.give
'''


@pytest.mark.parametrize(
    ("short", "full"),
    [
        (
            Parameter.level(0.1, 0.0, 1.0, spread=0.2),
            Parameter("level", 0.1, 0.0, 1.0, spread=0.2, size="value", null=0.0, label="{value}"),
        ),
        (
            Parameter.level(0.1, -1.0, 1.0, name="sine", tries=(0.3,)),
            Parameter(
                "sine",
                0.1,
                -1.0,
                1.0,
                size="value",
                null=0.0,
                label="sine_{value}",
                tries=(0.3,),
            ),
        ),
        (
            Parameter.share("share", 0.1, 0.0, 1.0),
            Parameter("share", 0.1, 0.0, 1.0, null=0.0),
        ),
        (
            Parameter.slope("drag", "velocity/velocity", 0.1, 0.0, 1.0),
            Parameter("drag", 0.1, 0.0, 1.0, size="value/velocity/velocity", null=0.0),
        ),
        (
            Parameter.width("give", 0.1, 0.01, 1.0, factor=3.0, hard=True),
            Parameter("give", 0.1, 0.01, 1.0, spread=3.0, log=True, size="position", hard=True),
        ),
        (
            Parameter.time(0.1, 0.0, 1.0, spread=0.2),
            Parameter("time_constant", 0.1, 0.0, 1.0, "s", spread=0.2, null=0.0),
        ),
        (
            Parameter.time(4.0, 0.0, 20.0, name="delay", size="period"),
            Parameter("delay", 4.0, 0.0, 20.0, size="period", null=0.0),
        ),
        (
            Parameter.time(0.1, 0.01, 1.0, factor=2.0),
            Parameter("time_constant", 0.1, 0.01, 1.0, "s", spread=2.0, log=True),
        ),
        (
            Parameter.positive("mass", 1.0, 0.1, 10.0, "kg", factor=1.3),
            Parameter("mass", 1.0, 0.1, 10.0, "kg", spread=1.3, log=True),
        ),
        (
            Parameter.held("ratio", 20.0, 1.0, 100.0).with_source("counted teeth"),
            Parameter("ratio", 20.0, 1.0, 100.0, fitted=False, source="counted teeth"),
        ),
    ],
)
def test_a_constructor_states_the_fields_of_its_kind(short, full):
    assert short == full
    assert short.outside_name == full.outside_name


def test_an_effect_file_that_states_every_field_is_sound(tmp_path):
    """Its parameters are those of the catalogue's effect of the same equation."""
    path = tmp_path / "seal_friction.py"
    path.write_text(EFFECT)
    found, names = effects_with((str(path),))
    assert names == ["seal-friction"]
    level = found["seal-friction"].parameters[0]
    assert level == effects()["coulomb-friction"].parameters[0].with_source("a seal")


@pytest.mark.parametrize("sensor", ["angle-sensor-lag", "pressure-sensor-gain"])
def test_a_sensor_of_one_unit_acts_on_its_readings_alone(sensor):
    effect = effects()[sensor]
    assert (effect.kinds, effect.general_kinds) == (("reading",), ())
    assert [effect.suits_unit(unit) for unit in ("rad", "Pa", "m")] == [
        sensor.startswith("angle"),
        sensor.startswith("pressure"),
        False,
    ]
