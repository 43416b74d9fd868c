"""Local refinement: least squares with an L1 term, a prior and a box. Arrays and callables only."""

from ._least_squares import LeastSquares as LeastSquares
from ._problem import AbstractRefiner as AbstractRefiner, Refined as Refined, RefineProblem as RefineProblem
from ._shooting import Shooting as Shooting, shooting as shooting
