"""Files: cell files and exports of recordings.

What users need most is in :mod:`coopqp`. The names here are the rest: the cell files of coopqp, the schema of cell
files, and files that are written whole or not at all.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__, __file__, gone={"RenamedKeyWarning": "a key of version 0.1 is a CellFileError, which names the new key"}
)
