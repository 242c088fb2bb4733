"""Run of a model file by MuJoCo alone, at a given step and integrator, on recorded stretches.

The start state of every stretch is estimated from its first readings by damped Gauss-Newton with
finite differences. Then the simulation runs freely on the recorded inputs. Commands are held or
linear between samples, as in the recording. Readings between two steps are interpolated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pamid.base.arrays import Array
from pamid.base.schemas.command_files import PlainSettings
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_file import MujocoFile

START_ITERATIONS = 12  # of the search for a start; a step without gain raises the damping
GROWING_ITERATIONS = 3  # over each of the growing beginnings before
GUESS_INFORMATION = 1e-5  # pull to the start of a search, relative to the readings' information
STATE_DIFFERENCE = 1e-6  # of a state, for the slopes of the search
SLOPE_SAMPLES = 9  # readings whose slope is the first velocity
LEAST_DESCENT = 1e-4  # share of the cost below which the search ends


@dataclass(frozen=True, eq=False)
class RecordedStretch:
    """Successive samples of a run.

    times     (samples,) s, from 0
    inputs    column -> (samples,), SI
    before    column -> (earlier samples,), SI: content of a delay at the start
    readings  column -> (samples,), SI; NaN if there is none
    scored    (samples,) mask of the samples that count
    opening   samples that determine the start
    """

    times: Array
    inputs: Mapping[str, Array]
    before: Mapping[str, Array]
    readings: Mapping[str, Array]
    scored: NDArray[np.bool_]
    opening: int


INTEGRATORS = {
    "mjINT_EULER": "Euler",
    "mjINT_RK4": "RK4",
    "mjINT_IMPLICIT": "implicit",
    "mjINT_IMPLICITFAST": "implicitfast",
}


class PlainModel:
    """A model file in MuJoCo, with the columns of a recording at its commands and sensors."""

    def __init__(
        self,
        file: MujocoFile,
        mechanism: Mechanism,
        *,
        settings: PlainSettings | None = None,
        linear: Sequence[str] = (),
    ) -> None:
        from mujoco import rollout

        self.mujoco, self.mechanism, self.linear = file.mujoco, mechanism, frozenset(linear)
        self.model = m = file.copy()
        if settings is not None:
            m.opt.timestep = settings.timestep_s
            m.opt.integrator = next(
                int(getattr(self.mujoco.mjtIntegrator, key))
                for key, name in INTEGRATORS.items()
                if name == settings.integrator
            )
        # an unstable run must stay visible, so MuJoCo must not reset it
        m.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.data, self.rollout = self.mujoco.MjData(m), rollout
        kinds = self.mujoco.mjtState
        self.spec = int(kinds.mjSTATE_CTRL) | int(kinds.mjSTATE_QFRC_APPLIED)
        self.full = kinds.mjSTATE_FULLPHYSICS
        self.states = m.nq + m.nv + m.na

    @property
    def settings(self) -> PlainSettings:
        word = self.mujoco.mjtIntegrator(int(self.model.opt.integrator)).name
        return PlainSettings(
            timestep_s=float(self.model.opt.timestep), integrator=INTEGRATORS.get(word, word)
        )

    def errors(
        self, stretches: Sequence[RecordedStretch], noise: Mapping[str, float]
    ) -> dict[str, float]:
        """Mean absolute error per column over all scored samples, SI; infinite for an unstable run.

        noise: standard deviations by column, SI, which weight the readings at the start.
        """
        total = dict.fromkeys(noise, 0.0)
        count = dict.fromkeys(noise, 0)
        for stretch in stretches:
            (simulated,) = self.simulate(stretch, self.start_of(stretch, noise)[None])
            for k, column in enumerate(stretch.readings):
                miss = np.abs(stretch.readings[column] - simulated[:, k])[stretch.scored]
                seen = ~np.isnan(stretch.readings[column][stretch.scored])
                bad = ~np.isfinite(simulated[stretch.scored, k]).all()
                total[column] += np.inf if bad else float(miss[seen].sum())
                count[column] += int(seen.sum())
        return {c: total[c] / count[c] if count[c] else np.nan for c in noise}

    # ---- a run ----------------------------------------------------------------------------------

    def simulate(
        self, stretch: RecordedStretch, starts: Array, samples: int | None = None
    ) -> Array:
        """Readings in the order of the stretch's columns (starts x samples x columns) from states
        (starts x states): positions, velocities, activations."""
        m, n = self.model, samples or len(stretch.times)
        step = float(m.opt.timestep)
        count = int(np.ceil(stretch.times[n - 1] / step - 1e-6)) + 1
        control = self._control(stretch, np.arange(count, dtype=np.float64) * step, n)
        begin = np.tile(self._begin(stretch), (len(starts), 1))
        begin[:, 1 : 1 + self.states] = starts
        states, sensed = self.rollout.rollout(
            m,
            self.data,
            begin,
            np.broadcast_to(control, (len(starts), *control.shape)),
            control_spec=self.spec,
        )
        # a sensor is read at the start of a step, a state is returned at its end
        states = np.concatenate([begin[:, None], states], axis=1)
        at = stretch.times[:n] / step
        first = np.minimum(np.floor(at + 1e-6).astype(int), count - 1)
        after = np.minimum(first + 1, count - 1)
        share = np.clip(at - first, 0.0, 1.0)[:, None]
        share[share < 1e-6] = 0.0
        rows = self._read(states[:, :count], sensed, list(stretch.readings))
        readings: Array = rows[:, first] + share * (rows[:, after] - rows[:, first])
        return readings

    def _read(self, states: Array, sensed: Array, columns: Sequence[str]) -> Array:
        """Readings per step, (starts x steps x columns)."""
        m, named = self.mechanism, {s.column: s for s in self.mechanism.sensors}
        readings = []
        for column in columns:
            sensor = named[column]
            if sensor.adr >= 0:
                readings.append(sensed[:, :, sensor.adr])
            elif sensor.mount is not None:
                readings.append(self._attitude(states, sensor.mount.body)[sensor.component])
            else:
                joint = m.joints[sensor.of]
                velocity = sensor.kind == "jointvel"
                place = 1 + (self.model.nq + joint.dof if velocity else joint.qpos)
                readings.append(states[:, :, place])
        return np.stack(readings, axis=2)

    def _attitude(self, states: Array, body: int) -> Array:
        """Quaternion (4, ...) of a floating base from its yaw, pitch and roll."""
        hinges = [j for j in self.mechanism.joints if j.body == body and j.is_base][3:]
        angles = np.stack([states[..., 1 + joint.qpos] for joint in hinges], axis=-1)
        turned = Rotation.from_euler("ZYX", angles.reshape(-1, 3))
        return turned.as_quat(scalar_first=True).T.reshape(4, *angles.shape[:-1])

    def _control(self, stretch: RecordedStretch, times: Array, samples: int) -> Array:
        """Commands and applied forces per step, (steps x both)."""
        m = self.model
        control = np.zeros((len(times), m.nu + m.nv))
        held = np.searchsorted(stretch.times[:samples], times * (1.0 + 1e-9) + 1e-9, "right") - 1
        for a in self.mechanism.actuators:
            if not a.column or a.column not in stretch.inputs:
                continue
            values = stretch.inputs[a.column][:samples]
            linear = a.column in self.linear
            row = np.interp(times, stretch.times[:samples], values) if linear else values[held]
            place = a.adr if a.adr >= 0 else m.nu + self.mechanism.joints[a.joint].dof
            control[:, place] = row
        return control

    def _begin(self, stretch: RecordedStretch) -> Array:
        """Full state of MuJoCo, in which delays contain the previous commands and readings."""
        m, d, mujoco = self.model, self.data, self.mujoco
        mujoco.mj_resetData(m, d)
        if m.nhistory:
            self._fill_history(stretch)
        state = np.zeros(mujoco.mj_stateSize(m, self.full))
        mujoco.mj_getState(m, d, state, self.full)
        return state

    def _fill_history(self, stretch: RecordedStretch) -> None:
        m, d = self.model, self.data
        step, period = float(m.opt.timestep), float(stretch.times[1] - stretch.times[0])
        for i, a in enumerate(self.mechanism.actuators):
            size = int(m.actuator_history[i, 0]) if a.adr >= 0 else 0
            if size and a.column in stretch.inputs:
                times = -step * np.arange(size, 0, -1)
                past = np.append(
                    stretch.before.get(a.column, np.empty(0)), stretch.inputs[a.column][0]
                )
                # the last is the first sample of the stretch, at time 0
                back = np.minimum(np.ceil(-times / period - 1e-6).astype(int), len(past) - 1)
                self.mujoco.mj_initCtrlHistory(m, d, i, times, past[len(past) - 1 - back])
        for sensor in self.mechanism.sensors:
            # the last sensor that begins there or before: a sensor may have several values
            number = int(np.searchsorted(m.sensor_adr, sensor.adr, "right")) - 1
            number = number if sensor.adr >= 0 else -1
            size = int(m.sensor_history[number, 0]) if number >= 0 else 0
            if size and sensor.column in stretch.readings:
                value = np.nan_to_num(stretch.readings[sensor.column][0])
                times = -step * np.arange(size, 0, -1)
                self.mujoco.mj_initSensorHistory(m, d, number, times, np.full(size, value), 0.0)

    # ---- the state at the start ------------------------------------------------------------------

    def start_of(self, stretch: RecordedStretch, noise: Mapping[str, float]) -> Array:
        """Estimate the state (states,) at the start of a stretch from its first readings.

        Ever longer beginnings are fitted, because over a long one an error of the first guess grows
        too far for its slopes.
        """
        most = max(2, min(stretch.opening, len(stretch.times)))
        x, samples = self._guess(stretch), 2
        while samples < most:
            x = self._fitted_start(stretch, noise, x, samples, GROWING_ITERATIONS)
            samples *= 2
        return self._fitted_start(stretch, noise, x, most, START_ITERATIONS)

    def _fitted_start(
        self,
        stretch: RecordedStretch,
        noise: Mapping[str, float],
        x: Array,
        samples: int,
        iterations: int,
    ) -> Array:
        """Damped Gauss-Newton from a start x (states,) over the first samples."""
        y = np.column_stack([values[:samples] for values in stretch.readings.values()])
        weight = 1.0 / np.array([noise[column] for column in stretch.readings])
        weight = np.where(np.isnan(y), 0.0, weight)
        y, guess = np.nan_to_num(y), x

        def residuals(starts: Array) -> Array:
            simulated = self.simulate(stretch, starts, samples)
            return ((simulated - y) * weight).reshape(len(starts), -1)

        by = STATE_DIFFERENCE * np.maximum(1.0, np.abs(x))
        rows = residuals(x + np.concatenate([np.zeros((1, len(x))), np.diag(by)]))
        cost, damping = float(rows[0] @ rows[0]), 1e-3
        for _ in range(iterations):
            if not np.isfinite(rows).all():
                return x
            slopes, r = (rows[1:] - rows[0]).T / by, rows[0]
            hessian = slopes.T @ slopes
            # a state that the readings do not show stays at its guess
            scale = np.diag(hessian) + 1e-9 * max(float(np.diag(hessian).max()), 1e-12)
            pull = GUESS_INFORMATION * np.diag(hessian)
            step = slopes.T @ r + pull * (x - guess)
            tried = x - np.linalg.solve(hessian + np.diag(damping * scale + pull), step)
            rows = residuals(tried + np.concatenate([np.zeros((1, len(x))), np.diag(by)]))
            new = float(rows[0] @ rows[0]) if np.isfinite(rows).all() else np.inf
            if new < cost:
                gain, cost, x, damping = 1.0 - new / cost, new, tried, max(0.1 * damping, 1e-9)
                if gain < LEAST_DESCENT:
                    break
            else:
                damping *= 30.0
                rows = np.concatenate([r[None], r + by[:, None] * slopes.T])
        return x

    def _guess(self, stretch: RecordedStretch) -> Array:
        """Positions and velocities from the joints' sensors, else the reference at rest.

        A filter starts at its first command.
        """
        m = self.model
        x = np.concatenate([m.qpos0, np.zeros(m.nv + m.na)])
        few = slice(0, min(SLOPE_SAMPLES, len(stretch.times)))
        for sensor in self.mechanism.sensors:
            y = stretch.readings.get(sensor.column, np.array([np.nan]))[few]
            if sensor.kind not in ("jointpos", "jointvel") or np.isnan(y).any():
                continue
            joint = self.mechanism.joints[sensor.of]
            if sensor.kind == "jointvel":
                x[m.nq + joint.dof] = y[0]
                continue
            slope, level = np.polyfit(stretch.times[few], y, 1)
            x[joint.qpos] = level
            if not any(s.kind == "jointvel" and s.of == sensor.of for s in self.mechanism.sensors):
                x[m.nq + joint.dof] = slope
        for i, a in enumerate(self.mechanism.actuators):
            act = int(m.actuator_actadr[i]) if a.adr >= 0 and a.motor is None else -1
            if act >= 0 and a.column in stretch.inputs:
                filtered = a.dynamics == "filter"
                at = x[self.mechanism.joints[a.joint].qpos] if a.joint >= 0 else 0.0
                x[m.nq + m.nv + act] = stretch.inputs[a.column][0] if filtered else at
        return x
