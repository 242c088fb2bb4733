"""HDF5 files, also those that Octave saves.

Only what lies in the file itself is read: links to other files and objects are not followed, cells
of Python objects, texts and references are left out by name.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pamid.intake.logs.channel_builder import ChannelBuilder
from pamid.intake.logs.log_kinds import Kind

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
            unit = _unit(dataset)
            builder.budget.charge(name, 0, raw=dataset.size * dataset.dtype.itemsize)
            values = dataset[()]
            if dataset.dtype.names is None:
                builder.add(name, values, unit=unit)
            for field in dataset.dtype.names or ():
                builder.add(f"{name}/{field}", np.asarray(values[field]), unit=unit)


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
            continue
        if not octave and not isinstance(item, h5py.Dataset):
            continue
        kind = item.dtype
        if item.external or item.is_virtual:
            builder.leave_out(inside, "stored in another file")
        elif kind.hasobject or kind.kind in "OSUV" and kind.names is None:
            builder.leave_out(inside, "not numbers")
        elif item.shape is None:
            continue
        elif not item.id.get_storage_size():  # reading it would make its fill value of nothing
            builder.leave_out(inside, "declared but not written")
        elif builder.reserve(inside, item.shape, kind.itemsize):
            for field in kind.names or ():
                values = item.size * math.prod(kind[field].shape)
                builder.budget.charge(f"{inside}/{field}", values)
            datasets[inside] = item


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


def _unit(dataset: Any) -> str:
    attributes = dataset.attrs
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
