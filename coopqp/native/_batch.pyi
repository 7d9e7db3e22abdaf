from coopqp.spatial import Array

def place(arm: Array, q: Array, poses: Array, jacobians: Array, /) -> None: ...
def solve(
    arm: Array,
    poses: Array,
    q: Array,
    residuals: Array,
    tolerance: float,
    steps: int,
    longest: float,
    damping: float,
    /,
) -> None: ...
def singular_values(matrices: Array, rows: int, columns: int, values: Array, /) -> None: ...
def walk(
    arm: Array, poses: Array, q: Array, reached: Array, tolerance: float, longest: float, halvings: int, /
) -> None: ...
