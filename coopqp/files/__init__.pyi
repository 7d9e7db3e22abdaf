from .cellfile import (
    CELLS as CELLS,
    CellFileError as CellFileError,
    example_path as example_path,
    json_schema as json_schema,
    load_cell_file as load_cell_file,
    schema_text as schema_text,
)
from .export import write_bag as write_bag, write_csv as write_csv
