"""Excitations as files, read back by who would play them: Octave, a C compiler, a parser of
structured text."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported import STRICT

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.excitation.writers import FORMATS, change_points, write_excitation

PERIOD = 0.003
needs_octave = pytest.mark.skipif(
    shutil.which("octave-cli") is None, reason="octave-cli is not installed"
)
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


def columns(samples: int = 2000) -> dict[str, Array]:
    """Two columns with numbers that need all their bits: held levels, and a sine that never
    rests."""
    held = aprbs(samples * PERIOD, PERIOD, 40.0, seed=1)
    return {"reference_1_deg": held, "command_2": 0.7 * np.sin(np.arange(samples) / 37.0) / 3.0}


def write(
    path: Path,
    form: str,
    sent: dict[str, Array] | None = None,
    period_s: float = PERIOD,
    **more: Any,
) -> dict[str, Any]:
    return write_excitation(
        path, sent or columns(), period_s, {"rig": "one-dof", "seed": 1}, form=form, **more
    )


def octave(script: str, folder: Path) -> None:
    call = ["octave-cli", "--no-init-file", "--eval", script]
    done = subprocess.run(call, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def dumped(path: Path, shape: tuple[int, ...]) -> Array:
    """Doubles as Octave wrote them, column by column."""
    return np.fromfile(path, dtype="<f8").reshape(shape, order="F")


# ---- Simulink --------------------


@needs_octave
def test_octave_reads_every_mat_file_to_the_bit(tmp_path):
    sent = columns()
    for form in ("mat", "mat-file", "mat-matrix"):
        write(tmp_path / f"{form}.mat", form)
    octave(
        """
        a = load('mat.mat'); r = a.reference_1_deg; c = a.command_2;
        assert(r.signals.dimensions, 1); assert(r.signals.label, 'reference_1_deg');
        assert(size(r.time), [2000 1]); assert(size(r.signals.values), [2000 1]);
        assert(sort(fieldnames(a)), {'command_2'; 'reference_1_deg'});
        b = load('mat-file.mat'); d = load('mat-matrix.mat');
        f = fopen('out.bin', 'w');
        fwrite(f, r.time, 'double'); fwrite(f, r.signals.values, 'double'); fwrite(f, c.signals.values, 'double');
        fwrite(f, b.excitation', 'double'); fwrite(f, d.excitation, 'double'); fclose(f);
        """,  # noqa: E501
        tmp_path,
    )
    found = dumped(tmp_path / "out.bin", (2000, 9))
    wanted = np.stack([PERIOD * np.arange(2000), *sent.values()], axis=1)
    for first in (0, 3, 6):
        assert np.array_equal(found[:, first : first + 3], wanted)


# ---- C --------------------

MAIN = """
#include <stdio.h>
#include "my-sent.h"
int main(void)
{
    unsigned long k;
    printf("%d %.17g\\n", MY_SENT_SAMPLES, MY_SENT_PERIOD_S);
    for (k = 0; k < MY_SENT_SAMPLES; k++) {
        printf("%.17g %.17g\\n", my_sent_reference_1_deg[k], my_sent_command_2[k]);
    }
    for (k = 0; k < MY_SENT_REFERENCE_1_DEG_CHANGES; k++) {
        printf("%.17g %.17g\\n", my_sent_reference_1_deg_change_s[k], my_sent_reference_1_deg_change[k]);
    }
    return 0;
}
"""  # noqa: E501


@needs_gcc
def test_a_strict_c99_compiler_takes_the_header_and_prints_the_numbers(tmp_path):
    sent = columns()
    write(tmp_path / "my-sent.h", "h")
    (tmp_path / "main.c").write_text(MAIN)
    for flags in (["-O0"], ["-O2", "-include", "my-sent.h"]):  # included twice: the guard holds
        done = subprocess.run(
            ["gcc", *STRICT, *flags, "main.c", "-o", "main"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    lines = subprocess.run(
        [tmp_path / "main"], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert lines[0].split() == ["2000", "0.0030000000000000001"]
    numbers = np.array([line.split() for line in lines[1:]], dtype=float)
    assert np.array_equal(numbers[:2000], np.stack(list(sent.values()), axis=1))
    at = change_points(sent["reference_1_deg"])
    assert np.array_equal(
        numbers[2000:], np.stack([PERIOD * at, sent["reference_1_deg"][at]], axis=1)
    )
    text = (tmp_path / "my-sent.h").read_text()
    assert "in deg, a value per sample" in text and "no unit" in text


# ---- structured text --------------------


def parsed(text: str) -> dict[str, Any]:
    """Constants of a VAR_GLOBAL block: numbers, times in s and arrays of them, counted against
    their bounds."""
    body = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
    inside = re.fullmatch(r"\s*VAR_GLOBAL CONSTANT(.*)END_VAR\s*", body, flags=re.DOTALL)
    assert inside is not None
    found: dict[str, Any] = {}
    for statement in filter(str.strip, inside.group(1).split(";")):
        declared = re.fullmatch(
            r"\s*([A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*) : (.*?) := (.*)",
            statement,
            flags=re.DOTALL,
        )
        assert declared is not None, statement
        name, kind, value = declared.groups()
        array = re.fullmatch(r"ARRAY\[1\.\.(\d+)\] OF (\w+)", kind)
        if array is None:
            found[name] = literal(kind, value)
            continue
        items = value.strip().removeprefix("[").removesuffix("]").split(",")
        assert len(items) == int(array.group(1))
        found[name] = np.array([literal(array.group(2), item) for item in items])
    return found


def literal(kind: str, text: str) -> float:
    text = text.strip()
    if kind == "DINT":
        return int(text)
    if kind == "REAL":
        assert re.fullmatch(r"-?\d+\.\d+(E-?\d+)?", text), text
        return float(np.float32(text))
    number = re.fullmatch({"TIME": r"T#(\d+)ms", "LTIME": r"LTIME#(\d+)ns"}[kind], text)
    assert number is not None, text
    return int(number.group(1)) * {"TIME": 1e-3, "LTIME": 1e-9}[kind]


@pytest.mark.parametrize("period_s", [0.003, 0.0005, 1.0 / 3000.0])
def test_the_change_points_of_the_plc_play_the_signal(period_s, tmp_path):
    sent = columns()
    write(tmp_path / "sent.st", "st", sent, period_s)
    text = (tmp_path / "sent.st").read_text()
    assert ("LTIME" in text) == (period_s != 0.003) and "in deg" in text
    found = parsed(text)
    assert found["sent_end"] == pytest.approx(2000 * period_s, abs=1e-9)
    middle = period_s * (np.arange(2000) + 0.5)
    for column, samples in sent.items():
        times, values = found[f"sent_{column}_time"], found[f"sent_{column}_value"]
        assert found[f"sent_{column}_count"] == times.size == values.size and times[0] == 0.0
        played = values[np.searchsorted(times, middle, side="right") - 1]
        assert np.array_equal(played, samples.astype(np.float32))
    assert found["sent_reference_1_deg_count"] < 15


# ---- beside them --------------------


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_not_finite_is_never_written(form, tmp_path):
    for wrong in (np.nan, np.inf):
        with pytest.raises(FileError, match="not finite"):
            write(
                tmp_path / f"sent{FORMATS[form].suffix}",
                form,
                {"force_n": np.array([0.0, wrong, 1.0])},
            )
    assert list(tmp_path.iterdir()) == []
