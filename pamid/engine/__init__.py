"""Equations to compiled simulation and exact sensitivities; nothing else in pamid imports numba or
LLVM. `symbolic` holds the expressions."""
