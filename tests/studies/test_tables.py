"""Tables of studies: what a cell of CSV and Parquet says, and what comes back."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import pytest

from coopqp.studies.table import cell_text, csv_bytes, parquet_bytes

COLUMNS = ("count", "share", "mixed", "name", "yes", "list", "empty")
ROWS: list[dict[str, Any]] = [
    {"count": 1, "share": 0.1 + 0.2, "mixed": 1, "name": 'ä, "b"', "yes": True, "list": [1, {"b": 2, "a": "ü"}]},
    {"count": -(2**40), "share": 1e-300, "mixed": "two", "name": "line\nbreak", "yes": False, "list": {}},
    {"count": None, "share": 3, "mixed": None, "name": None},
]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""), (True, "yes"), (False, "no"), (1, "1"), (1.0, "1.0"), (0.1 + 0.2, "0.30000000000000004"),
        ("", ""), ("a, b", "a, b"), ([1, "ü"], '[1, "ü"]'), ({"b": 1, "a": None}, '{"a": null, "b": 1}'),
    ],
)  # fmt: skip
def test_a_value_is_told_with_all_its_digits(value: Any, text: str) -> None:
    assert cell_text(value) == text


def test_csv_comes_back_as_it_was_written() -> None:
    written = csv_bytes(COLUMNS, ROWS)
    assert written.startswith(b"count,share,mixed,name,yes,list,empty\n")
    assert b"\r" not in written
    read = list(csv.DictReader(io.StringIO(written.decode())))
    assert len(read) == len(ROWS)
    for row, found in zip(ROWS, read, strict=True):
        assert found == {name: cell_text(row.get(name)) for name in COLUMNS}
    assert float(read[0]["share"]) == 0.1 + 0.2
    assert json.loads(read[0]["list"]) == ROWS[0]["list"]


def test_parquet_keeps_numbers_as_numbers_and_the_rest_as_text() -> None:
    pytest.importorskip("pyarrow")
    from pyarrow import parquet

    table = parquet.read_table(io.BytesIO(parquet_bytes(COLUMNS, ROWS)))
    kinds = dict(zip(table.column_names, map(str, table.schema.types), strict=True))
    assert kinds == {
        "count": "int64", "share": "double", "mixed": "string", "name": "string", "yes": "string", "list": "string",
        "empty": "int64",
    }  # fmt: skip
    found = table.to_pydict()
    assert found["count"] == [1, -(2**40), None]
    assert found["share"] == [0.1 + 0.2, 1e-300, 3.0]
    assert found["mixed"] == ["1", "two", None]
    assert found["name"] == ['ä, "b"', "line\nbreak", None]
    assert found["yes"] == ["yes", "no", None]
    assert found["list"] == ['[1, {"a": "ü", "b": 2}]', "{}", None]
    assert found["empty"] == [None, None, None]
