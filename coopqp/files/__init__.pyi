from .cellfile import (
    CELLS as CELLS,
)
from .cellfile import (
    CellFileError as CellFileError,
)
from .cellfile import (
    example_path as example_path,
)
from .cellfile import (
    json_schema as json_schema,
)
from .cellfile import (
    load_cell_file as load_cell_file,
)
from .cellfile import (
    schema_text as schema_text,
)
from .export import write_bag as write_bag
from .export import write_csv as write_csv
