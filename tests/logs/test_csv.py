"""CSV tables: cells that are numbers, texts or lists, lines by number, and files that are no tables."""

import gzip

import numpy as np
import pandas as pd
import pytest

from skat.logs import LogError
from skat.logs.readers import csv, recording


def recorded(path, text):
    path.write_text(text)
    (stream,) = csv.read(path).streams
    return stream


@pytest.mark.parametrize("n_at_once", [1, 3, 7, 100])
def test_a_table_is_the_same_in_chunks_of_any_size(tmp_path, monkeypatch, n_at_once):
    monkeypatch.setattr(csv, "ROWS_AT_ONCE", n_at_once)
    lines = [
        f'{index},{index / 7!r},"[{index}, null, -{index}]",{"x" if index == 5 else index}'
        for index in range(7)
    ]
    stream = recorded(tmp_path / "a.csv", "\n".join(["t, value ,v,mixed", *lines, ""]))
    assert list(stream.columns) == ["t", "value", "v[0]", "v[1]", "v[2]", "mixed"]
    found = stream.read(["t", "v[2]", "v[1]", "mixed", "value"])
    np.testing.assert_array_equal(found["t"], np.arange(7.0))
    np.testing.assert_array_equal(found["value"], np.arange(7) / 7)  # every digit
    np.testing.assert_array_equal(found["v[2]"], -np.arange(7.0))
    assert np.isnan(found["v[1]"]).all()
    assert found["mixed"][5] == "x"
    np.testing.assert_array_equal(np.delete(found["mixed"], 5).astype(float), [0, 1, 2, 3, 4, 6])


def test_empty_cells_are_not_measured_and_infinity_is_a_number(tmp_path):
    text = "a,b\n1,x\n,y\nNaN,z\nnull,w\n inf ,v\n-INF,u\nnone,t\n+nan,s\n-infinity,r\n"
    found = recorded(tmp_path / "a.csv", text).read(["a", "b"])
    expected = [1, np.nan, np.nan, np.nan, np.inf, -np.inf, np.nan, np.nan, -np.inf]
    np.testing.assert_array_equal(found["a"], expected)
    assert found["b"].tolist() == list("xyzwvutsr")
    words = recorded(tmp_path / "b.csv", "a,b\n1,2\nhigh,3\n").read(["a"])["a"]
    assert words.tolist() == ["1", "high"]


@pytest.mark.parametrize(("cells", "size"), [("1 2 3", 3), ("1, 2", 2), ("7", 1)])
def test_lists_are_separated_by_commas_or_spaces(tmp_path, cells, size):
    stream = recorded(tmp_path / "a.csv", f't,v\n0,"[{cells}]"\n1,\n')
    assert list(stream.columns) == ["t", *(f"v[{element}]" for element in range(size))]
    found = stream.read([f"v[{size - 1}]"])[f"v[{size - 1}]"]
    np.testing.assert_array_equal(found, [float(cells.replace(",", " ").split()[-1]), np.nan])


@pytest.mark.parametrize("cell", ["[1, 2]", "[1, 2, 3, 4]", "[1, 2, x]"])
def test_a_list_of_another_length_is_located_by_its_line(tmp_path, cell):
    stream = recorded(tmp_path / "a.csv", f't,v\n0,"[1, 2, 3]"\n\n1,"[1, 2, 3]"\n2,"{cell}"\n')
    with pytest.raises(LogError, match=r"line 5, column v: expected a list of 3 numbers"):
        stream.read(["v[0]"])


def test_lines_are_counted_with_blank_ones_and_those_within_quotes(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text('\nt,v\n0,1\n\n1,"two\nlines"\n2,3\n')
    assert [csv.line_of(path, row) for row in range(3)] == [3, 6, 7]
    assert csv.line_of(path, 10) == 12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3\n4,5,6\n", r"line 1: holds numbers \(1, 2, 3, \.\.\.\)"),
        ("a,b,a\n1,2,3\n", "names two columns 'a'"),
        ("a;b\n1;2\n", "another mark than commas"),
        ("a\tb\n1\t2\n", "another mark than commas"),
        ("a,b\n1,2,3\n", "is not a CSV table"),
    ],
)
def test_what_is_no_table_is_refused_with_the_reason(tmp_path, text, message):
    with pytest.raises(LogError, match=message):
        recorded(tmp_path / "a.csv", text).read(["a"])


def test_compressed_tables_and_marks_at_their_beginning_are_read(tmp_path):
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress("\ufeffa,b\n1,2\n".encode()))
    (stream,) = csv.read(path).streams
    assert list(stream.columns) == ["a", "b"]
    np.testing.assert_array_equal(stream.read(["a"])["a"], [1.0])
    path.write_bytes(gzip.compress(b"a,b\n" + b"1,2\n" * 9999)[:60])
    with pytest.raises(LogError, match="is cut or damaged"):
        csv.read(path).streams[0].read(["a"])


def test_columns_of_one_kind_stay_it():
    floats, texts = np.array([1.0, 2.0]), np.array(["a"], dtype=object)
    assert csv._concatenated([floats]) is floats
    assert csv._concatenated([floats, floats]).dtype == float
    mixed = csv._concatenated([floats, texts])
    assert (mixed.dtype, mixed.tolist()) == (object, [1.0, 2.0, "a"])
    assert csv._numbers(pd.Series([True, False])).tolist() == [1.0, 0.0]


@pytest.mark.parametrize("is_compressed", [False, True])
@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("a,b\n1,2,3\n", "A CSV table has a line of names, and as many values in each row."),
        (
            "a,b;c\n1,2,3,4\n",
            "The file seems to be separated by another mark than commas: write it with commas between columns, and "
            "points in numbers.",
        ),
    ],
)
def test_a_table_that_is_ragged_is_told_so_also_where_it_is_compressed(tmp_path, text, advice, is_compressed):
    path = tmp_path / "a.csv"
    path.write_bytes(gzip.compress(text.encode()) if is_compressed else text.encode())
    with pytest.raises(LogError) as caught:
        csv.read(path).streams[0].read(["a"])
    assert caught.value.problem.startswith("is not a CSV table: ")
    assert caught.value.problem.endswith(".")
    assert (caught.value.where, caught.value.advice) == (str(path), advice)


def test_words_that_pandas_takes_for_nothing_are_words_in_a_column_of_words(tmp_path):
    found = recorded(tmp_path / "a.csv", "a,b\nNA,1\nx,2\nn/a,\n").read(["a", "b"])
    assert found["a"].tolist() == ["NA", "x", "n/a"]
    np.testing.assert_array_equal(found["b"], [1, 2, np.nan])


@pytest.mark.parametrize(
    "text", ['{"time": {"0": 0.0, "1": 0.1}, "q": {"0": 0.0}}', '\n[{"time": 0.0, "q": 0.0}]\n']
)
def test_json_is_called_so_and_not_a_table_with_names_that_come_twice(tmp_path, text):
    path = tmp_path / "log.json"
    path.write_text(text)
    with pytest.raises(LogError, match="is JSON, which is not read"):
        recording(path)
