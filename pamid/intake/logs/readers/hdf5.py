"""HDF5 files, also those that Octave saves.

Only what lies in the file itself is read: links to other files and objects are not followed, cells
of Python objects, texts and references are left out by name.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pamid.intake.logs.channel_builder import ChannelBuilder, Kind

UNIT_NAMES = ("unit", "units", "Unit", "Units", "UNIT", "UNITS", "unit_string")


def read_hdf5(builder: ChannelBuilder) -> None:
    """Every dataset of numbers as a channel without stamps, named by its groups; fields of
    compounds separately."""
    import h5py

    with h5py.File(builder.path, "r") as file:
        datasets: dict[str, Any] = {}
        _group(builder, datasets, file, "", frozenset())
        # the sum of all is known before any is read
        for name, dataset in datasets.items():
            _read(builder, dataset, name)


def _group(
    builder: ChannelBuilder, datasets: dict[str, Any], group: Any, name: str, above: frozenset[int]
) -> None:
    """Enter the datasets below a group that can be channels into `datasets`, by name."""
    import h5py

    address = int(h5py.h5o.get_info(group.id).addr)
    if address in above:
        return
    for key in group:
        inside = f"{name}/{key}" if name else key
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            builder.leave_out(inside, "a link")
            continue
        item = group[key]
        octave = isinstance(item, h5py.Group) and "OCTAVE_NEW_FORMAT" in item.attrs
        if octave and set(item) == {"type", "value"}:
            item = item["value"]
        if isinstance(item, h5py.Group):
            _group(builder, datasets, item, inside, above | {address})
        elif octave or isinstance(item, h5py.Dataset):
            _dataset(builder, datasets, item, inside)


def charge_hdf5(builder: ChannelBuilder) -> None:
    """Charge every dataset of a file that another library reads whole, as float64."""
    import h5py

    def charge(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            columns = len(item.dtype.names or ("",))
            raw = item.size * item.dtype.itemsize
            builder.budget.charge(name, columns * item.size, raw=raw)

    with h5py.File(builder.path, "r") as file:
        file.visititems(charge)


def _dataset(builder: ChannelBuilder, datasets: dict[str, Any], dataset: Any, name: str) -> None:
    if dataset.external or dataset.is_virtual:
        builder.leave_out(name, "stored in another file")
        return
    if dataset.dtype.hasobject or dataset.dtype.kind in "OSUV" and dataset.dtype.names is None:
        builder.leave_out(name, "not numbers")
        return
    if dataset.shape is None:
        return
    if not dataset.id.get_storage_size():  # reading it would make its fill value of nothing
        builder.leave_out(name, "declared but not written")
        return
    kind = dataset.dtype
    if not builder.reserve(name, dataset.shape, kind.itemsize):
        return
    for field in kind.names or ():
        inside = math.prod(kind[field].shape)
        builder.budget.charge(f"{name}/{field}", dataset.size * inside)
    datasets[name] = dataset


def _read(builder: ChannelBuilder, dataset: Any, name: str) -> None:
    kind, unit = dataset.dtype, unit_of(dataset.attrs)
    builder.budget.charge(name, 0, raw=dataset.size * kind.itemsize)
    values = dataset[()]
    if kind.names is None:
        builder.add(name, values, unit=unit)
        return
    for field in kind.names:
        builder.add(f"{name}/{field}", np.asarray(values[field]), unit=unit)


def unit_of(attributes: Any) -> str:
    for name in UNIT_NAMES if len(attributes) else ():
        value = attributes.get(name)
        if isinstance(value, bytes):
            return value.decode(errors="replace")
        if isinstance(value, str):
            return value
    return ""


KIND = Kind(
    "hdf5", (".h5", ".hdf5", ".hdf", ".he5"), read_hdf5, (b"\x89HDF\r\n\x1a\n",), "hdf5", ("h5py",)
)
