"""LeRobot data sets: a folder with meta/info.json and Parquet files, or any of these files.

Vectors (`observation.state`, `action`) become a channel per joint, named as meta/info.json names
them. Every episode has the stamps of its frames, and a pause between itself and the next, longer
than any gap that is bridged, so that it becomes a separate recording. Videos are not opened.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.files import LOG, open_data
from pamid.base.json_file import read_json
from pamid.intake.logs.channel_builder import ChannelBuilder, Kind
from pamid.intake.logs.channel_words import JOINT_QUANTITIES, names_command, tokens
from pamid.intake.logs.channels import RobotValue
from pamid.intake.logs.readers.parquet import columns_of

INFO = Path("meta", "info.json")
PAUSE_S, PAUSE_FRAMES = 10.0, 1000.0  # between episodes, the longer of the two
#: columns that say where a frame belongs: no signals
_PLACES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
_EXACT = 1e-3  # s: stamps this near to frame / fps are that, rounded


def data_set_of(path: Path) -> Path | None:
    """The folder of the data set that a folder is, or a file lies in; None if it is none."""
    folders = [path] if path.is_dir() else list(path.absolute().parents)[:3]
    return next((folder for folder in folders if _features(folder)), None)


def _features(root: Path) -> dict[str, Any]:
    """The features in meta/info.json by name; {} where it is no such file."""
    if not (root / INFO).is_file():
        return {}
    try:
        info = read_json(root / INFO)
    except FileError:
        return {}
    features = info.get("features") if isinstance(info, dict) else None
    return features if isinstance(features, dict) else {}


def read_lerobot(builder: ChannelBuilder) -> None:
    """Channels "observation.state/NAME", with stamps in s, episode after episode; FileError if it
    is not a data set."""
    path = builder.path
    root = data_set_of(path)
    if root is None:
        raise FileError(
            f"{path}: there is no {INFO} with the features of a LeRobot data set.", code="damaged"
        )
    info, features = read_json(root / INFO), _features(root)
    files = [path] if path.is_file() else sorted((root / "data").rglob("*.parquet"))
    if not files:
        raise FileError(f"{root / 'data'}: there are no Parquet files.", code="no-signals")
    tables: list[dict[str, Any]] = []
    for file in files:
        open_data(file, LOG).close()  # a regular file of a size that can be read
        tables.append({name: values for name, values, _ in columns_of(builder, file)})
    wanted = [name for name in tables[0] if all(name in table for table in tables)]
    for name in {name for table in tables for name in table}.difference(wanted):
        builder.leave_out(name, "not in every file")
    whole: dict[str, Any] = {}
    for name in wanted:
        parts = [table[name] for table in tables]
        if len({part.shape[1:] for part in parts}) > 1:
            builder.leave_out(name, "another number of values from file to file")
            continue
        # the columns of the files, joined; then every channel
        builder.budget.charge(name, 2 * sum(part.size for part in parts))
        whole[name] = np.concatenate(parts)
    stamps = _stamps(builder, whole, info, files[0])
    for name, values in whole.items():
        if name not in _PLACES:
            _enter(builder, name, values, stamps, features.get(name))


# ---- the time ------------------------------------------------------------------------------------


def _stamps(
    builder: ChannelBuilder, columns: dict[str, Any], info: dict[str, Any], file: Path
) -> Array:
    """Stamps (n,) in s of every frame, episode after episode."""
    if "timestamp" not in columns:
        raise FileError(
            f"{file} lacks the column timestamp of a LeRobot data set.", code="no-signals"
        )
    stamps = np.asarray(columns["timestamp"], dtype=np.float64)
    if stamps.ndim != 1 or not np.isfinite(stamps).all():
        raise FileError(f"{file}: timestamp is not a number in every row.", code="stamps")
    # the stamps without the rounding of single precision
    frames, fps = columns.get("frame_index"), info.get("fps")
    if (
        frames is not None
        and isinstance(fps, int | float)
        and not isinstance(fps, bool)
        and fps > 0
    ):
        even = np.asarray(frames, dtype=np.float64) / fps
        if even.shape == stamps.shape and np.abs(even - stamps).max() < min(_EXACT, 0.05 / fps):
            builder.note(f"stamps: frame_index / {fps:g}, which timestamp agrees with")
            stamps = even
    episode = np.asarray(columns.get("episode_index", np.zeros(len(stamps))))
    begins = [0, *(np.flatnonzero(np.diff(episode) != 0) + 1).tolist(), len(stamps)]
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    pause, end = max(PAUSE_S, PAUSE_FRAMES * step), 0.0
    shifted, notes = np.empty_like(stamps), []
    for first, last in zip(begins[:-1], begins[1:], strict=True):
        inside = stamps[first:last]
        if not inside.size:
            continue
        shifted[first:last] = inside - inside.min() + end
        notes.append(f"{float(episode[first]):g} from {end:g} s")
        end = float(np.ceil(shifted[first:last].max() + pause))
    shown = notes if len(notes) <= 8 else [*notes[:6], "...", notes[-1]]
    builder.note(f"{len(notes)} episodes, each a recording: {', '.join(shown)}")
    return shifted


# ---- the vectors ---------------------------------------------------------------------------------


def _enter(builder: ChannelBuilder, name: str, values: Any, stamps: Array, feature: Any) -> None:
    if values.ndim == 1 or values.shape[1] == 1:
        values = values.reshape(len(values), -1)
    size = values.shape[1]
    names = _names(feature, size)
    of_robot = name.startswith("action") or (
        name.startswith("observation") and not name.startswith("observation.environment")
    )
    of_group = next((JOINT_QUANTITIES[w] for w in tokens(name) if w in JOINT_QUANTITIES), "")
    for place in range(size):
        axis_name = names[place] if names else ""
        label = f"{name}/{axis_name or place + 1}" if size > 1 or axis_name else name
        robot = None
        if of_robot:
            # "shoulder_pan.pos" is a position of shoulder_pan
            element, _, ending = axis_name.rpartition(".")
            quantity = JOINT_QUANTITIES.get(ending, "") if element else ""
            element, quantity = (element, quantity) if quantity else (axis_name, of_group)
            robot = RobotValue(name, element, place, size, quantity, names_command(name))
        builder.add(label, values[:, place], stamps, robot=robot)
    if of_robot and not names and size > 1:
        builder.note(f"{name}: {INFO} does not name its {size} values")


def _names(feature: Any, size: int) -> list[str]:
    """Names of a vector's values in meta/info.json; [] unless all of them have distinct names
    there."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        lists = [part for part in names.values() if isinstance(part, list)]
        names = [name for part in lists for name in part]
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        return []
    return names if len(names) == size == len(set(names)) else []


KIND = Kind("lerobot", (), read_lerobot, (), "parquet", ("pyarrow",))
