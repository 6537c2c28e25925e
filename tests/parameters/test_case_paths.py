"""Paths in case files."""

from erosion.parameters.case_files import with_paths


def test_text_that_is_no_path_stays(tmp_path):
    table = {
        "title": "of plug.py", "k": "normal(2, 0.1)", "model": "linearized,a.py", "n": 3, "target": "copper",
        "uncertain": {"k": " samples( in (1).csv ) "}, "set": {"x": ["a.csv", 2]}, "warning": "see draws.nc",
    }  # fmt: skip
    assert with_paths(table, lambda path: f"f/{path}") == table | {
        "model": "linearized,f/a.py", "uncertain": {"k": " samples( f/in (1).csv ) "}, "set": {"x": ["f/a.csv", 2]},
    }  # fmt: skip
