"""Small symmetric systems in registers.

A matrix is a dictionary of its lower triangle, (i, j) -> Dr.Jit value, i >= j. It omits entries that are
always 0. The loops here run only while a kernel is traced.
"""

from typing import Any

PIVOT = 4  # least pivot, in rounding errors of its diagonal entry: a smaller one is rounding alone
TINY = 1e-12  # added to the diagonal, for unknowns that neither photos nor prior determine

Matrix = dict[tuple[int, int], Any]


def factor(matrix: Matrix, size: int) -> Matrix:
    """The lower Cholesky factor L of a positive definite matrix; the diagonal is stored inverted."""
    import drjit as dr

    lower: Matrix = {}
    for j in range(size):
        diagonal = matrix[j, j] + TINY
        pivot = diagonal
        for k in range(j):
            if (j, k) in lower:
                pivot = pivot - dr.square(lower[j, k])
        lower[j, j] = dr.rsqrt(dr.maximum(pivot, PIVOT * dr.epsilon(diagonal) * diagonal))
        for i in range(j + 1, size):
            products = [lower[i, k] * lower[j, k] for k in range(j) if (i, k) in lower and (j, k) in lower]
            if (i, j) in matrix or products:
                lower[i, j] = (matrix.get((i, j), 0.0) - sum(products)) * lower[j, j]
    return lower


def solved(lower: Matrix, right: list) -> list:
    """The solution x of L L^T x = right; ``lower`` is L."""
    x, size = list(right), len(right)
    for i in range(size):
        x[i] = (x[i] - sum(lower[i, k] * x[k] for k in range(i) if (i, k) in lower)) * lower[i, i]
    for i in reversed(range(size)):
        x[i] = (x[i] - sum(lower[k, i] * x[k] for k in range(i + 1, size) if (k, i) in lower)) * lower[i, i]
    return x


def inverse_diagonal(lower: Matrix, size: int) -> list:
    """The diagonal of (L L^T)^-1: the sums of squares of the columns of L^-1."""
    import drjit as dr

    found = []
    for u in range(size):
        column = {u: lower[u, u]}
        for i in range(u + 1, size):
            products = [lower[i, k] * column[k] for k in column if (i, k) in lower]
            if products:
                column[i] = -sum(products) * lower[i, i]
        found.append(sum(dr.square(value) for value in column.values()))
    return found


def log_determinant(lower: Matrix, size: int) -> Any:
    """Log det L L^T."""
    import drjit as dr

    return -2 * sum(dr.log(lower[u, u]) for u in range(size))
