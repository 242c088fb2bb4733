"""Text logs of every dialect: what can be told is read and said, what can be read in two ways is
refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pamid.base.errors import FileError
from pamid.intake.logs.channels import Log
from pamid.intake.logs.log_reader import read_log

N = 60
TIME = np.arange(N) * 0.003
ANGLE = np.round(40.0 * np.sin(7.0 * TIME) - 0.123456789, 9)
PRESSURE = np.round(300.0 + 50.0 * np.cos(5.0 * TIME), 6)
COUNT = np.arange(N) % 7 + 1


def rows(*columns: Any, delimiter: str = ",", decimal: str = ".", end: str = "\n") -> str:
    """A table of numbers; texts stay as they are."""
    lines = (
        delimiter.join(
            cell if isinstance(cell, str) else repr(float(cell)).replace(".", decimal)
            for cell in row
        )
        for row in zip(*columns, strict=True)
    )
    return end.join(lines) + end


def read(folder: Path, text: str, encoding: str = "utf-8", name: str = "log.csv") -> Log:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return read_log(path)


def said(log: Log, *words: str) -> bool:
    return any(all(word in detail for word in words) for detail in log.details)


def holds(log: Log, **columns: Any) -> None:
    """The log has these channels in this order and no others, all without stamps."""
    assert [channel.name for channel in log.channels] == list(columns)
    for channel, values in zip(log.channels, columns.values(), strict=True):
        assert channel.stamps is None
        np.testing.assert_allclose(channel.values, values, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", "   "])
@pytest.mark.parametrize("decimal", [".", ","])
def test_delimiters_and_decimal_marks(tmp_path, delimiter, decimal):
    table = (
        delimiter.join(("t", "angle", "p1"))
        + "\n"
        + rows(TIME, ANGLE, PRESSURE, delimiter=delimiter, decimal=decimal)
    )
    if delimiter == decimal:
        with pytest.raises(FileError, match="decimal marks") as caught:
            read(tmp_path, table)
        assert caught.value.code == "two-commas"
        return
    log = read(tmp_path, table)
    holds(log, t=TIME, angle=ANGLE, p1=PRESSURE)
    assert said(log, "decimal comma" if decimal == "," else "decimal point")


def test_preamble_units_czech_and_carriage_returns(tmp_path):
    head = (
        "Záznam č. 7;příliš žluťoučký\r\nPerioda;0,003\r\nKp;0,1\r\nKd;0,003\r\n\r\nČas;Úhel;Tlak "
        "1;\r\n"
        "[s];[°];[bar];\r\n"
    )
    table = rows(TIME, ANGLE, PRESSURE, [""] * N, delimiter=";", decimal=",", end="\r\n")
    for encoding, word in (
        ("utf-8-sig", "utf-8"),
        ("utf-8", "utf-8"),
        ("cp1250", "cp1250"),
        ("utf-16", "utf-16"),
    ):
        log = read(tmp_path, head + table, encoding)
        holds(log, **{"Čas": TIME, "Úhel": ANGLE, "Tlak 1": PRESSURE})
        assert [channel.unit for channel in log.channels] == ["s", "°", "bar"]
        assert (
            said(log, "encoding", word)
            and said(log, "names: line 6; units: line 7")
            and said(log, "5 lines above")
        )


def test_units_in_names_quotes_duplicates_and_comment_marks(tmp_path):
    log = read(
        tmp_path,
        '"Time [ms]","Winkel, ist (deg)","p","p","q (1)",""\n'
        + rows(TIME, ANGLE, ANGLE, ANGLE, ANGLE, COUNT),
    )
    assert [(channel.name, channel.unit) for channel in log.channels] == [
        ("Time", "ms"),
        ("Winkel, ist", "deg"),
        ("p", ""),
        ("p (2)", ""),
        ("q (1)", ""),
        ("column_6", ""),
    ]
    log = read(tmp_path, "# made by hand\n# t angle\n" + rows(TIME, ANGLE, delimiter=" "))
    holds(log, t=TIME, angle=ANGLE)
    log = read(
        tmp_path, "% t\tangle\n% s\tdeg\n" + rows(TIME, ANGLE, delimiter="\t"), name="log.txt"
    )
    holds(log, t=TIME, angle=ANGLE)
    assert [channel.unit for channel in log.channels] == ["s", "deg"]


def test_columns_are_numbers_or_said(tmp_path):
    """pandas' own guess of the delimiter leaves every column a text, without a word; here none may
    stay one."""
    state = ["run", "stop"] * (N // 2)
    odd = [repr(float(value)) for value in ANGLE]
    odd[4], odd[9], odd[10] = "", "NaN", "1.#QNAN"
    hurt = [repr(float(value)) for value in ANGLE]
    hurt[7] = "OVERFLOW"
    log = read(
        tmp_path,
        "t;state;odd;hurt;on;big\n"
        + rows(
            TIME,
            state,
            odd,
            hurt,
            ["TRUE", "FALSE"] * (N // 2),
            [f"{1_700_000_000_000_000_000 + 3 * index}" for index in range(N)],
            delimiter=";",
        ),
    )
    assert [channel.name for channel in log.channels] == ["t", "odd", "hurt", "on", "big"]
    assert all(channel.values.dtype == np.float64 for channel in log.channels)
    assert np.flatnonzero(np.isnan(log.channel("odd").values)).tolist() == [4, 9, 10]
    assert np.flatnonzero(np.isnan(log.channel("hurt").values)).tolist() == [7]
    np.testing.assert_array_equal(log.channel("on").values, [1.0, 0.0] * (N // 2))
    np.testing.assert_array_equal(log.channel("big").values, 3.0 * np.arange(N))
    assert (
        said(log, "left out", "state")
        and said(log, "hurt", "OVERFLOW", "row 8")
        and said(log, "beyond float64")
    )


@pytest.mark.parametrize(
    ("cells", "code"),
    [
        (["1.234,5"] * N, "thousands"),
        (["1 234,5"] * N, "thousands"),
        (["1'234.5"] * N, "thousands"),
        (["1,234"] * N, "thousands"),
        (["1,5", "1.5"] * (N // 2), "decimal-mark"),
    ],
)
def test_thousands_and_mixed_marks_are_refused(tmp_path, cells, code):
    with pytest.raises(FileError) as caught:
        read(tmp_path, "n;x\n" + rows([str(index) for index in range(N)], cells, delimiter=";"))
    assert caught.value.code == code


def test_commas_without_names_to_count_them_are_refused(tmp_path):
    whole = "".join(f"{index},{index + 1}\n" for index in range(N))
    with pytest.raises(FileError, match="which commas"):
        read(tmp_path, whole)
    holds(read(tmp_path, "a,b\n" + whole), a=np.arange(N), b=np.arange(N) + 1)
    holds(read(tmp_path, "a\n" + whole), a=[float(f"{index}.{index + 1}") for index in range(N)])
    holds(read(tmp_path, rows(TIME, ANGLE)), column_1=TIME, column_2=ANGLE)
    quoted = "".join(f'"{index},5","{index},25"\n' for index in range(N))
    holds(read(tmp_path, "a,b\n" + quoted), a=np.arange(N) + 0.5, b=np.arange(N) + 0.25)


def test_names_that_do_not_fit_and_ragged_rows_are_refused(tmp_path):
    table = rows(TIME, ANGLE, PRESSURE)
    with pytest.raises(FileError, match=r"line 1 has 4 names \(a, b, c, d\).* 3 columns"):
        read(tmp_path, "a,b,c,d\n" + table)
    lines = ("a,b,c\n" + table).split("\n")
    for cells, line in (("1.0,2.0", 31), ("1.0,2.0,3.0,4.0", 31), ("1.0,2.0", 3)):
        hurt = [*lines[: line - 1], cells, *lines[line:]]
        with pytest.raises(FileError, match=f"line {line}"):
            read(tmp_path, "\n".join(hurt))


def test_a_log_that_was_cut_loses_its_last_row_and_says_so(tmp_path):
    table = "t,angle\n" + rows(TIME, ANGLE)
    for lost in range(1, 25):
        log = read(tmp_path, table[:-lost])
        kept = log.channel("t").values.size
        np.testing.assert_array_equal(log.channel("t").values, TIME[:kept])
        np.testing.assert_array_equal(log.channel("angle").values, ANGLE[:kept])
        whole = table[-lost - 1] == "\n"  # cut between two rows, which nobody can see
        assert kept >= N - 2 and (whole or said(log, "last line"))


STAMPS = np.datetime64("2024-03-01T23:59:59.950") + (np.arange(N) * 3).astype("timedelta64[ms]")


@pytest.mark.parametrize(
    "form",
    [
        "%Y-%m-%d %H:%M:%S.{ms}",
        "%Y/%m/%dT%H:%M:%S.{ms}Z",
        "%d.%m.%Y %H:%M:%S,{ms}",
        "%m/%d/%Y %I:%M:%S.{ms} %p",
        "%d-%m-%y %H:%M:%S.{ms}+0100",
        "%H:%M:%S.{ms}",
        "%H:%M:%S:{ms}",
    ],
)
def test_dates_and_times_become_seconds(tmp_path, form):
    moments = (STAMPS + np.timedelta64(12, "D")).tolist()  # the 13th is no month
    cells = [
        moment.strftime(form).format(ms=f"{moment.microsecond // 1000:03d}") for moment in moments
    ]
    log = read(tmp_path, "when;angle\n" + rows(cells, ANGLE, delimiter=";"))
    assert log.channel("when").unit == "s"
    np.testing.assert_allclose(log.channel("when").values, TIME, rtol=0, atol=1e-9)
    assert said(log, "when", cells[0])


# LabVIEW


def test_an_empty_cell_between_times_of_day_is_no_midnight(tmp_path):
    stamps = ["15:00:00", "15:00:01", "", "15:00:03", "15:00:04", "15:00:05"]
    table = "time,angle\n" + "".join(f"{stamp},{k}.5\n" for k, stamp in enumerate(stamps))
    log = read(tmp_path, table)
    moments = log.channels[0].values
    assert moments[[0, 1, 3, 4, 5]].tolist() == [0.0, 1.0, 3.0, 4.0, 5.0] and np.isnan(moments[2])
    assert not said(log, "midnight")


def lvm(x_columns: str, decimal: str, segments: int) -> str:
    tab = "\t"
    text = (
        tab.join(["LabVIEW Measurement", ""])
        + "\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
    )
    text += f"Decimal_Separator\t{decimal}\nMulti_Headings\tYes\nX_Columns\t{x_columns}\nTime_Pref\tRelative\n"  # noqa: E501
    text += "Operator\tjan\nDate\t2024/03/01\nTime\t12:00:00,5\n***End_of_Header***\t\n\t\n"
    names = {
        "One": ["X_Value", "angle", "p1", "Comment"],
        "No": ["X_Value", "angle", "p1", "Comment"],
        "Multi": ["X_Value", "angle", "X_Value", "p1", "Comment"],
    }[x_columns]
    for number in range(segments):
        text += f"Channels\t2\t\t\nSamples\t{N}\t{N}\t\nDate\t2024/03/01\t2024/03/01\nTime\t12:00:00,5\t12:00:00,5\n"  # noqa: E501
        text += "Y_Unit_Label\tdeg\tkPa\nX_Dimension\tTime\tTime\n"
        text += f"X0\t{number}{decimal}0E+0\t{number}{decimal}0E+0\t\nDelta_X\t0{decimal}003\t0{decimal}003\t\n"  # noqa: E501
        text += "***End_of_Header***\t\t\t\n" + tab.join(names) + "\n"
        x = TIME + number
        columns = {
            "One": (x, ANGLE, PRESSURE),
            "No": ([""] * N, ANGLE, PRESSURE),
            "Multi": (x, ANGLE, x + 0.001, PRESSURE),
        }[x_columns]
        text += rows(*columns, delimiter=tab, decimal=decimal) + "\n"
    return text.replace("\n", "\r\n")


@pytest.mark.parametrize("x_columns", ["One", "No", "Multi"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("segments", [1, 2])
def test_labview_measurement_files(tmp_path, x_columns, decimal, segments):
    log = read(tmp_path, lvm(x_columns, decimal, segments), name="rig.lvm")
    assert log.kind == "lvm"
    for number in range(segments):
        prefix = f"segment {number + 1}/" if segments > 1 else ""
        late = 0.001 if x_columns == "Multi" else 0.0
        for name, unit, values, shift in (
            ("angle", "deg", ANGLE, 0.0),
            ("p1", "kPa", PRESSURE, late),
        ):
            channel = log.channel(prefix + name)
            assert channel.unit == unit and channel.stamps is not None
            np.testing.assert_allclose(channel.values, values, rtol=1e-9)
            np.testing.assert_allclose(channel.stamps, TIME + number + shift, rtol=0, atol=1e-9)
    assert len(log.channels) == 2 * segments


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\n\n",
        "only words\nand more words\n",
        "a,b\n",
        "LabVIEW Measurement\t\n",
        "a\0b\n1\0 2\n",
        "t,angle\n1.0,x\n",
        '"' * 999,
        "s  " * 300 + "!\n1 2\n3 4\n5 6\n",
        "[" * 5000 + "\n" + "1,2,3\n" * 5,
    ],
)
def test_what_is_no_table_is_refused(tmp_path, text):
    for name in ("log.csv", "log.lvm"):
        with pytest.raises(FileError):
            read(tmp_path, text, name=name)
