"""Tables: what was written is read back, to the last digit."""

from jaxwillmore.io import read_history, write_table


def test_a_table_comes_back_with_all_digits(tmp_path):
    rows = [{"name": "a, b", "h": 0.1 + 0.2}, {"name": "c", "order": 3}]
    write_table(tmp_path / "table.csv", rows)
    back = read_history(tmp_path / "table.csv")
    assert back[0] == {"name": "a, b", "h": 0.1 + 0.2, "order": None}
    assert back[1] == {"name": "c", "h": None, "order": 3}


def test_a_table_replaces_the_one_before(tmp_path):
    for value in (1, 2):
        write_table(tmp_path / "table.csv", [{"x": value}])
    assert read_history(tmp_path / "table.csv") == [{"x": 2}]
