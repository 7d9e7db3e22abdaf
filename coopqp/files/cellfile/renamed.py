"""Keys that had other names in version 0.1: files with the old ones are read, and a warning lists them."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from coopqp.files.cellfile.error import RenamedKeyWarning

#: Old dotted keys of cell files, and the new name of the last part. A list of tables counts as each of them.
KEYS: Mapping[str, str] = {"controller.common_error.master": "leader", "controller.weights.comfort": "posture"}
#: Old values of keys, by dotted key, and their new names.
VALUES: Mapping[str, Mapping[str, str]] = {"controller.common_error.kind": {"master": "leader"}}


def renewed(tables: Any, source: str) -> Any:
    """Tables of a cell file with the present names; a table with both names of a key stays as it is.

    Args:
        tables: the tables, as they were read or recorded.
        source: where they come from, for the warning.

    Warns:
        RenamedKeyWarning: old names were found; one warning lists them all.
    """
    found: dict[str, str] = {}
    try:
        tables = copy.deepcopy(tables)
    except RecursionError:  # the schema refuses what is nested so deeply
        return tables
    for key, new in KEYS.items():
        *parents, old = key.split(".")
        for table in _tables(tables, parents):
            if old in table and new not in table:
                table[new] = table.pop(old)
                found[key] = ".".join([*parents, new])
    for key, names in VALUES.items():
        *parents, last = key.split(".")
        for table in _tables(tables, parents):
            value = table.get(last)
            if isinstance(value, str) and value in names:
                table[last] = names[value]
                found[f'{key} = "{value}"'] = f'{key} = "{names[value]}"'
    if found:
        listed = "; ".join(f"{old} is now {new}" for old, new in found.items())
        warnings.warn(f"{source} has names of version 0.1: {listed}", RenamedKeyWarning, stacklevel=2)
    return tables


def _tables(place: Any, keys: Sequence[str]) -> Iterator[dict[str, Any]]:
    """The tables at dotted keys."""
    if isinstance(place, list):
        for entry in place:
            yield from _tables(entry, keys)
    elif isinstance(place, dict) and keys:
        yield from _tables(place.get(keys[0]), keys[1:])
    elif isinstance(place, dict):
        yield place
