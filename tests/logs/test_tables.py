import pandas as pd
import pytest

from skat.logs.tables import numeric_columns, with_same_columns


@pytest.mark.parametrize("content", ["", "a,b\n1,2,3\n4,5\n", "a,b\n1,2,3\n4,5,6\n", "\0\0\0", "a,b\n"])
@pytest.mark.filterwarnings("default")
def test_a_file_that_holds_no_table_is_refused(tmp_path, content):
    """Also where warnings are no errors, as they are in these tests and not with users."""
    (tmp_path / "log.csv").write_text(content)
    with pytest.raises(ValueError, match=r"log\.csv"):
        numeric_columns(tmp_path / "log.csv")


def test_columns_are_matched_by_name():
    table = pd.DataFrame({"a": [1.0], "b": [2.0]})
    assert list(with_same_columns(table, table[["b", "a"]])) == ["b", "a"]
    with pytest.raises(ValueError, match="only one of them has: b, c"):
        with_same_columns(table, pd.DataFrame({"a": [1.0], "c": [2.0]}))


def test_a_value_that_is_no_number_is_named_with_its_line(tmp_path):
    (tmp_path / "log.csv").write_text("a,b\n1,2\n3,fast\n")
    with pytest.raises(ValueError, match=r"log\.csv, line 3, column b: expected a finite number, got 'fast'"):
        numeric_columns(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_text("a,b\n1,2\n3,1_0\n")
    with pytest.raises(ValueError, match=r"line 3, column b: expected a finite number, got '1_0'"):
        numeric_columns(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_text("a,b\n1,2\n3,\n")
    with pytest.raises(ValueError, match=r"line 3, column b: expected a finite number, got ''"):
        numeric_columns(tmp_path / "log.csv")


def test_blanks_about_a_name_are_none_of_it(tmp_path):
    (tmp_path / "log.csv").write_text("time , episode ,x\n0.10,01,2\n")
    table = numeric_columns(tmp_path / "log.csv", beside=["time", "episode"])
    assert table.to_dict("list") == {"time": ["0.10"], "episode": ["01"], "x": [2.0]}
