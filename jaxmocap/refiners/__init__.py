"""Local refinement: least squares with an L1 term, a prior and a box. Arrays and callables only."""

from ._base import AbstractRefiner as AbstractRefiner, Refined as Refined
from ._coordinate_descent import shooting as shooting
from ._least_squares import LeastSquares as LeastSquares
from ._problem import RefineProblem as RefineProblem
from ._shooting import Shooting as Shooting
