"""Tables as people have them, read by the command up to the fit."""

import codecs
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from manireg._cli.app import app
from manireg.datasets import read_table

AGE = np.array([0.0, 1.0, 2.5, 4.0])
LAT = np.array([10.5, -12.5, 45.25, 0.125])
LON = np.array([-70.0, 20.5, 0.25, 120.0])


class Seen(Exception):
    """What reached the fit."""


@pytest.fixture
def reach(tmp_path, monkeypatch):
    """Runs `manireg fit` with latitude and longitude up to the fit: the result, whose
    exception is `Seen(source, target, x, y)` where the table was read."""

    def chosen_fit(source, target, x, y, lam, data, *_, **__):
        raise Seen(source, target, x, y, data.get("weights"))

    monkeypatch.setattr("manireg._cli.fit.chosen_fit", chosen_fit)
    monkeypatch.chdir(tmp_path)

    def reach(content, *more, name="data.csv"):
        raw = content if isinstance(content, bytes) else content.encode()
        (tmp_path / name).write_bytes(raw)
        arguments = ["--target", "sphere", "--input", "age", "--lat-lon", "lat,lon"]
        arguments += ["--lam", "1", *map(str, more)]
        return CliRunner().invoke(app, ["fit", name, *arguments])

    return reach


def seen(result):
    assert isinstance(result.exception, Seen), result.output
    return result.exception.args


def lat_lon(y):
    return np.degrees([np.arcsin(y[:, 2]), np.arctan2(y[:, 1], y[:, 0])])


def assert_read(result, rows=(0, 1, 2, 3)):
    rows = list(rows)
    _, _, x, y, _ = seen(result)
    np.testing.assert_array_equal(x, AGE[rows])
    np.testing.assert_allclose(lat_lon(y), [LAT[rows], LON[rows]], atol=1e-12)


PLAIN = "age,lat,lon\n0,10.5,-70\n1,-12.5,20.5\n2.5,45.25,0.25\n4,0.125,120\n"
GERMAN = PLAIN.replace(",", ";").replace(".", ",")
HEADLESS = PLAIN.split("\n", 1)[1]

READ = {
    "plain": PLAIN,
    "semicolons": PLAIN.replace(",", ";"),
    "tabs": PLAIN.replace(",", "\t"),
    "bars": PLAIN.replace(",", "|"),
    "spaces": PLAIN.replace(",", "  "),
    "fixed width": "\n".join(
        "".join(f"{field:>9}" for field in line.split(",")) + " "
        for line in PLAIN.splitlines()
    ),
    "decimal commas": GERMAN,
    "decimal commas, tabs": GERMAN.replace(";", "\t"),
    "decimal commas, quoted": "age,lat,lon\n"
    + "".join(
        '"' + '","'.join(f.replace(".", ",") for f in line.split(",")) + '"\n'
        for line in HEADLESS.splitlines()
    ),
    "three decimals in a semicolon file": "age;lat;lon\n0,000;10,500;-70,000\n"
    "1,000;-12,500;20,500\n2,500;45,250;0,250\n4,000;0,125;120,000\n",
    "byte order mark": codecs.BOM_UTF8 + PLAIN.encode(),
    "UTF-16 little endian": codecs.BOM_UTF16_LE + PLAIN.encode("utf-16-le"),
    "UTF-16 big endian, tabs": codecs.BOM_UTF16_BE
    + PLAIN.replace(",", "\t").encode("utf-16-be"),
    "UTF-16 without a mark": PLAIN.encode("utf-16-le"),
    "Windows-1252": PLAIN.replace("\n", ";°\n")
    .replace(",", ";")
    .replace("lon;°", "lon;Höhe")
    .encode("cp1252"),
    "Windows line ends": PLAIN.replace("\n", "\r\n"),
    "old Mac line ends": PLAIN.replace("\n", "\r"),
    "mixed line ends": PLAIN.replace("\n", "\r\n", 2),
    "no line end at the end": PLAIN.rstrip("\n"),
    "blank lines": "\n\n" + PLAIN.replace("\n", "\n\n") + "  \n,,\n",
    "comment lines": "# poles\n# of one, plate\n"
    + PLAIN.replace("\n", "\n# more\n", 2),
    "MATLAB comments": "% poles\n" + PLAIN,
    "C comments": "// poles\n" + PLAIN,
    "header in the comment": "# poles\n# " + PLAIN,
    "header in the comment, spaces": "# " + PLAIN.replace(",", " "),
    "header case and spaces": PLAIN.replace("age,lat,lon", " Age , LAT,Lon "),
    "quoted header": PLAIN.replace("age,lat,lon", '"age",\'lat\',"lon"'),
    "all quoted": "".join(
        '"' + line.replace(",", '", "') + '"\n' for line in PLAIN.splitlines()
    ),
    "extra columns": PLAIN.replace("\n", ',"Smith, J. ""x""",NA\n').replace(
        'lon,"Smith, J. ""x""",NA', "lon,author,note"
    ),
    "trailing separators": PLAIN.replace("\n", ",\n"),
    "trailing separators below": PLAIN.replace("\n", ",\n").replace("lon,", "lon"),
    "many trailing separators": PLAIN.replace(",", ";").replace("\n", ";;;\n"),
    "row names of R": PLAIN.replace("age", '"",age')
    .replace("\n0,", '\n"1",0,')
    .replace("\n1,", '\n"2",1,')
    .replace("\n2.5,", '\n"3",2.5,')
    .replace("\n4,", '\n"4",4,'),
    "row names of R without a name": '"age" "lat" "lon"\n"1" 0 10.5 -70\n'
    '"2" 1 -12.5 20.5\n"3" 2.5 45.25 0.25\n"4" 4 0.125 120\n',
    "Excel's hint": "sep=;\n" + PLAIN.replace(",", ";"),
    "Unicode minus": PLAIN.replace("-", "\u2212"),
    "dash for minus, Windows-1252": PLAIN.replace("-", "\u2013").encode("cp1252"),
    "degree signs": PLAIN.replace(".5,", ".5°,").replace("70\n", "70 °\n"),
    "hemispheres": "age,lat,lon\n0,10.5N,70W\n1,12.5 S,20.5°E\n"
    "2.5,N45.25,E 0.25\n4,0.125n,120e\n",
    "degrees and minutes": "age,lat,lon\n0,10°30',70°W\n1,12°30'0\"S,20° 30′ 0″ E\n"
    '2.5,"45°15\'0""N",0°15\'E\n4,0°7\'30"N,120°E\n',
    "exponents": PLAIN.replace("\n2.5,", "\n2.5e0,").replace("120", "1.2E2"),
    "Fortran's exponents": PLAIN.replace("\n2.5,", "\n0.25D+01,"),
    "no-break spaces": PLAIN.replace(",", ",\u00a0").replace("\n", "\u00a0\n"),
    "plus signs": PLAIN.replace(",10.5", ",+10.5"),
    "line break in a text": PLAIN.replace("\n", ',"two\nlines"\n'),
}


@pytest.mark.parametrize("variant", READ)
def test_read(reach, variant):
    assert_read(reach(READ[variant]))


def test_line_of_units(reach):
    result = reach(PLAIN.replace("lon\n", "lon\nMa,deg,[deg]\n"))
    assert_read(result)
    assert "note: data.csv: line 2 has units (Ma, deg, [deg])" in result.stderr


def test_home(reach, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "folder").mkdir()
    result = reach(PLAIN, "--out", "~/folder/out.csv")
    assert_read(result)
    with pytest.raises(FileNotFoundError):
        read_table("~/none.csv")
    np.testing.assert_array_equal(read_table("~/data.csv")["age"], AGE)


@pytest.mark.parametrize(
    "gap", ["NA", "", "-", "--", "nan", "N/A", "null", "None", "."]
)
@pytest.mark.parametrize("column", ["age", "lat", "lon"])
def test_rows_with_gaps_are_left_out(reach, gap, column):
    place = {"age": "\n2.5,", "lat": "45.25", "lon": ",0.25"}[column]
    whole = place.strip(",\n")
    broken = PLAIN.replace(place, place.replace(whole, gap))
    result = reach("# one line more\n" + broken)
    assert_read(result, [0, 1, 3])
    shown = f"'{gap}'" if gap else "empty"
    assert result.stderr == (
        "manireg: note: data.csv: 1 of 4 rows have missing values and are left out: data "
        f"row 3 (line 5); first, column `{column}` is {shown} in data row 3 (line 5).\n"
    )
    refused = reach("# one line more\n" + broken, "--missing", "error")
    assert refused.exit_code == 2
    assert (
        f"data.csv: column `{column}` is empty or not finite in 1 of 4 rows, first "
        f"{shown} in data row 3 (line 5)." in refused.stderr
    )


def test_gaps_count_only_in_columns_that_are_used(reach):
    table = PLAIN.replace("\n", ",NA\n").replace("lon,NA", "lon,w")
    result = reach(table, "--missing", "error")
    assert_read(result)
    assert result.stderr == ""
    weighted = reach(table, "--weights", "w")
    assert "no row has values in all of age, lat, lon, w; first" in weighted.stderr


def test_many_rows_are_told_in_runs(reach):
    rows = [f"{i},{'NA' if i in (1, 4, 5, 6) else i},{i}" for i in range(9)]
    result = reach("age,lat,lon\n" + "\n".join(rows))
    assert len(seen(result)[2]) == 5
    assert "4 of 9 rows" in result.stderr
    assert "data rows 2, 5 to 7 (lines 3, 6 to 8)" in result.stderr


REFUSED = {
    "age": (
        PLAIN.replace("\n2.5,", "\nabc,"),
        "column `age` has text, 'abc'; --input needs",
    ),
    "several": (
        PLAIN.replace("-12.5", "x").replace("45.25", "y"),
        "column `lat` has text, 'x'; --lat-lon needs numbers (in 2 rows, first in data "
        "row 2 (line 3)).",
    ),
    "comments count as lines": (
        "# a\n\n" + PLAIN.replace("45.25", "#DIV/0!"),
        "has text, '#DIV/0!'; --lat-lon needs numbers (data row 3 (line 6)).",
    ),
    "thousands, quoted": (
        PLAIN.replace("0,10.5", '"1,000",10.5').replace("\n2.5,", '\n"2,500",'),
        "'1,000' can be read in two ways, with a decimal or a thousands separator",
    ),
    "thousands, tabs": (
        PLAIN.replace(",", "\t").replace("\n2.5", "\n2,500"),
        "'2,500' can be read in two ways",
    ),
    "thousands of Germany": (
        GERMAN.replace("0;10,5", "1.000;10,5"),
        "column `age`: '1.000' can be read in two ways",
    ),
    "thousands with both": (
        PLAIN.replace(",", ";").replace("120", "1,120.5"),
        "'1,120.5' can be read in two ways",
    ),
    "millions": (
        GERMAN.replace("4;", "4,000,000;"),
        "'4,000,000' can be read in two ways",
    ),
    "thousands of Switzerland": (
        PLAIN.replace("\n2.5,", "\n2'500,"),
        "'2'500' can be read in two ways",
    ),
    "thousands with spaces": (
        PLAIN.replace("\n2.5,", "\n2\u202f500,"),
        "'2 500' can be read in two ways",
    ),
    "decimal commas between commas": (
        PLAIN.replace(".", ","),
        "data.csv, line 2: 4 fields, but the header has 3 columns. Quote entries with",
    ),
    "longitude in a latitude": (
        PLAIN.replace("-12.5", "12.5E"),
        "column `lat`: '12.5E' has the hemisphere 'E', but the column is a latitude",
    ),
    "latitude in an age": (
        PLAIN.replace("\n2.5,", "\n2.5S,"),
        "'2.5S' has the hemisphere 'S', but the column is neither latitude nor",
    ),
    "sign and hemisphere": (
        PLAIN.replace("-12.5", "-12.5S"),
        "'-12.5S' has a sign and a hemisphere",
    ),
    "minutes": (PLAIN.replace("-12.5", "12°75'"), "'12°75'' is no angle in degrees"),
    "units": (PLAIN.replace("120", "120 km"), "has text, '120 km'; --lat-lon needs"),
    "underscores": (PLAIN.replace("120", "1_20"), "has text, '1_20'; --lat-lon needs"),
    "infinite": (PLAIN.replace("120", "inf"), "`lon` is empty or not finite in 1 of 4"),
    "out of range": (
        PLAIN.replace("45.25", "95.25"),
        "latitude `lat` leaves [-90, 90] degrees. Give --lat-lon as latitude,longitude "
        "(found 95.25 in data row 3 (line 4)).",
    ),
    "long line": (
        PLAIN.replace("45.25,", "45.25,1,"),
        "line 4: 4 fields, but the header has 3 columns",
    ),
    "short line": (
        PLAIN.replace(",120", ""),
        "line 5: 2 fields, but the header has 3 columns. Is the line cut off?",
    ),
    "title": ("A title\n" + PLAIN, "line 2: 3 fields, but the header has 1 column"),
    "one column": ("age\n1\n2\n", "no column `lat` for --lat-lon. It has: age."),
    "names twice": (PLAIN.replace("lon", "lat"), "has the column `lat` twice"),
    "two names alike": (
        PLAIN.replace("age,lat", "AGE,Age"),
        "several columns that `age` for --input may be: AGE, Age. Write one as it is",
    ),
    "close names": (
        PLAIN.replace("age", "ages"),
        "It has: ages, lat, lon. Did you mean",
    ),
    "no header": (HEADLESS, "That looks like data: give the table a header line."),
    "empty": ("", "data.csv: needs a header line and at least one row."),
    "only comments": (
        "# a,b\n\n",
        "data.csv: needs a header line and at least one row.",
    ),
    "only a header": ("age,lat,lon\n", "needs a header line and at least one row."),
    "open quote": (
        PLAIN.replace("45.25", '"45.25'),
        "Is a quote opened and not closed?",
    ),
    "workbook": (b"PK\x03\x04rest", "data.csv is an Excel workbook or another zip"),
    "binary": (b"\x01\x02\x00\x00\x00\x81", "data.csv is no text that can be read"),
}


@pytest.mark.parametrize("variant", REFUSED)
def test_refused(reach, variant):
    table, message = REFUSED[variant]
    result = reach(table)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert result.stderr.startswith("manireg: data.csv") and result.stderr.endswith(
        "\n"
    )
    assert result.stderr.count("\n") == 1


def test_names_with_commas(reach):
    table = PLAIN.replace("age", '"age, Ma"')
    result = reach(table, "--input", '"age, ma"')
    assert_read(result)


def test_tables_are_not_overwritten(reach):
    result = reach(PLAIN, "--out", "data.csv")
    assert "--out data.csv is a table to read; name another file." in result.stderr
    Path("ages.csv").write_text("age\n1\n")
    result = reach(
        PLAIN, "--predict", "ages.csv", "--out", "../" + Path.cwd().name + "/ages.csv"
    )
    assert "ages.csv is a table to read; name another file." in result.stderr


def test_predict_is_a_count_or_a_file(reach):
    for count in ("1e3", "-5", "2.5"):
        result = reach(PLAIN, f"--predict={count}")
        assert (
            f"--predict {count} is no whole number, and no such file." in result.stderr
        )


def test_constant_input(reach):
    table = "age,lat,lon\n" + "1700000000.25,1,2\n1700000000.25,3,4\n"
    assert "column `age` is constant, 1700000000.25." in reach(table).stderr
    table = PLAIN.replace("lon\n", "lon,z\n").replace("0\n", "0,7\n")
    table = table.replace("5\n", "5,7\n")
    assert "column `z` is constant, 7." in reach(table, "--input", "age,z").stderr


def test_gaps_in_what_is_asked(reach):
    Path("ages.csv").write_text("Age;note\n1,5;\n-;x\n2;\n")
    result = reach(PLAIN, "--predict", "ages.csv")
    assert_read(result)
    assert "note: ages.csv: 1 of 3 rows have missing values" in result.stderr
    assert "column `Age` is '-' in data row 2 (line 3)." in result.stderr
    assert "--missing drop" in reach(
        PLAIN, "--predict", "ages.csv", "--missing", "error"
    ).stderr  # fmt: skip


def test_read_table_keeps_texts(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text("time;plat;name;grid\n2024-05-01;12,5S;NA;a\n2024-05-02;-;b;-\n")
    table = read_table(file)
    assert list(table["time"]) == ["2024-05-01", "2024-05-02"]
    np.testing.assert_array_equal(table["plat"], [-12.5, np.nan])
    assert list(table["name"]) == ["NA", "b"] and list(table["grid"]) == ["a", "-"]
