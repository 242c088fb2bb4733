"""Elements and attributes that the installed MuJoCo reads in a model file.

Some of them came with later versions: delays of actuators and sensors, nonlinear springs and
dampers, and motors without a command that model friction.
"""

from __future__ import annotations

from functools import lru_cache


@lru_cache
def schema() -> dict[str, frozenset[str]]:
    """Attributes by element, as "actuator/motor" and "body/joint", of the installed MuJoCo."""
    import mujoco

    attributes: dict[str, set[str]] = {}
    section = element = ""
    for line in mujoco.mj_printSchema(False, False).splitlines():
        words = line.split()
        if len(words) > 1 and words[1].startswith("("):
            depth = (len(line) - len(line.lstrip())) // 3
            name = words[0].removeprefix("(world)")
            if depth == 1:
                section = name
            element = f"{section}/{name}" if depth == 2 else name if depth < 2 else ""
            words = words[2:]
        if element:
            attributes.setdefault(element, set()).update(words)
    return {name: frozenset(words) for name, words in attributes.items()}


def reads(element: str, attribute: str) -> bool:
    """True if the installed MuJoCo reads this attribute of an element, "actuator/motor"."""
    return attribute in schema().get(element, frozenset())


@lru_cache
def reads_polynomials() -> bool:
    """True if springs and dampers of joints may be polynomials."""
    import mujoco

    return hasattr(mujoco.MjModel, "dof_dampingpoly")
