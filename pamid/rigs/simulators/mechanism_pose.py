"""Line drawing of the bodies of a mechanism.

The lines join every joint with the next, and end at the centre of mass of the last body. The view
is along the world axis about which most hinges turn.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from pamid.base.arrays import Array
from pamid.base.errors import DataError
from pamid.rigs.simulators.mechanism import Mechanism, Vector
from pamid.rigs.simulators.spatial import rotation

#: world axis of the view -> axes that point to the right and up, x y z
SEEN = {0: (1, 2), 1: (0, 2), 2: (0, 1)}


def mechanism_pose(m: Mechanism, y: Mapping[str, Array]) -> dict[str, Array]:
    """Last body of a chain -> its chain (samples, points, 2), m; y: readings by column, SI.

    DataError if no sensor reads the position of a joint.
    """
    positions = {}
    for k, joint in enumerate(m.joints):
        column = next((s.column for s in m.sensors if s.kind == "jointpos" and s.of == k), None)
        if column is None or joint.kind not in ("hinge", "slide"):
            raise DataError(
                f"{m.name!r} cannot be drawn: no sensor reads the position of joint "
                f"{joint.name!r}.",
                "Give the model a jointpos sensor for every hinge and slide.",
                code="no-pose",
            )
        positions[k] = y[column]
    size = len(next(iter(positions.values()), np.zeros(1)))
    places = [np.zeros((size, 3))]
    turns = [np.broadcast_to(np.eye(3), (size, 3, 3))]
    anchors = [places[0]]
    axes = np.zeros(3)
    for number, body in enumerate(m.bodies[1:], start=1):
        above, turn = places[body.parent], turns[body.parent]
        place = above + _turned(turn, body.position)
        turn = turn @ rotation(body.quaternion)
        anchor = place
        for k, joint in enumerate(m.joints):
            if joint.body != number:
                continue
            way = positions[k] - joint.reference
            anchor = place + _turned(turn, joint.anchor)
            axis = _turned(turn, joint.axis)
            if joint.kind == "slide":
                place = place + way[:, None] * axis
                anchor = anchor + way[:, None] * axis
            else:
                axes += np.abs(axis[0])
                turn = turn @ Rotation.from_rotvec(np.outer(way, joint.axis)).as_matrix()
                place = anchor - _turned(turn, joint.anchor)
        places.append(place)
        turns.append(turn)
        anchors.append(anchor)
    right, up = SEEN[int(np.argmax(axes)) if axes.any() else 1]
    return {
        m.bodies[last].name: np.stack(
            [
                *(anchors[link] for link in m.lineage(last)),
                places[last] + _turned(turns[last], m.bodies[last].centre),
            ],
            axis=1,
        )[:, :, [right, up]]
        for last in _ends(m)
    }


def _ends(m: Mechanism) -> list[int]:
    """Bodies that carry no other, and that a joint moves."""
    parents = {body.parent for body in m.bodies[1:]}
    return [k for k in range(1, len(m.bodies)) if k not in parents and m.chain(k)]


def _turned(turn: Array, vector: Vector) -> Array:
    """Rotated vector, (samples, 3)."""
    return np.asarray(turn @ np.asarray(vector))
