"""Files: cell files and exports of recordings.

What users need most is in :mod:`coopqp`. The names here are the rest: the cell files of coopqp, the schema of cell
files, and files that are written whole or not at all.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.files.cellfile import CELLS, example_path, json_schema, schema_text
    from coopqp.output import write_files
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.files.cellfile": "CELLS example_path json_schema schema_text",
            "coopqp.output": "write_files",
        },
    )

__all__ = ["CELLS", "example_path", "json_schema", "schema_text", "write_files"]
