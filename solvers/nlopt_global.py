"""Global algorithms of NLopt."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import nlopt
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, Gt, Incompatible, MeteredProblem, Solver, SolverInfo

from ._finite import Finite

__all__ = [
    "AGS",
    "CRS2LM",
    "ESCH",
    "ISRES",
    "MLSL",
    "MLSLLBFGS",
    "Direct",
    "DirectL",
    "DirectLRand",
    "StoGO",
    "StoGORand",
]

AGS_DIMENSIONS = 10  # the limit that is compiled into NLopt
STOP = -1e300  # below NLopt's stopval (0.5·STOP), so that every algorithm ends when it receives this value


def run(
    algorithm: int,
    problem: MeteredProblem,
    rng: np.random.Generator,
    population: int | None = None,
    local: Any = None,
) -> None:
    """Run an NLopt algorithm in the unit box until the budget is used up or the algorithm ends.

    An algorithm that needs a starting point starts at the best point of ``problem.start``, if there is one, or else at
    a uniform random point. NLopt has one generator for the whole process; it is seeded from ``rng`` before each run.
    The value +inf makes DIRECT give up and AGS crash, so it is replaced by the worst finite value so far, with a zero
    gradient. A value together with its gradient counts as one evaluation.

    population: population size; None: NLopt's default.
    local: NLopt optimizer for the local searches of MLSL; None for the other algorithms.
    """
    n = problem.dimension
    width = problem.upper - problem.lower
    finite = Finite(start=1e100)
    ended: list[BaseException] = []

    def evaluate(u: Float[ndarray, " n"], gradient: Float[ndarray, " m"]) -> float:
        x = problem.from_unit(u)
        if not gradient.size:
            return finite.one(problem(x))
        value, slope = problem.value_and_gradient(x)
        gradient[:] = np.where(np.isfinite(slope), slope * width, 0.0)
        return finite.one(value)

    def objective(u: Float[ndarray, " n"], gradient: Float[ndarray, " m"]) -> float:
        if not ended:
            try:
                return evaluate(u, gradient)
            except BaseException as error:  # StoGO would continue forever, and L-BFGS would report a failure
                ended.append(error)
        gradient[:] = 0.0
        return STOP

    optimizer = nlopt.opt(algorithm, n)
    optimizer.set_lower_bounds(0.0)
    optimizer.set_upper_bounds(1.0)
    optimizer.set_min_objective(objective)
    optimizer.set_stopval(0.5 * STOP)
    if population is not None:
        optimizer.set_population(population)
    if local is not None:
        optimizer.set_local_optimizer(local)
    nlopt.srand(int(rng.integers(1, 2**31 - 1)))
    try:
        with contextlib.suppress(nlopt.RoundoffLimited):  # rounding errors prevent further progress
            optimizer.optimize(problem.first_point(rng))
    finally:
        del optimizer  # the garbage collector cannot see its reference to the objective and to an error's frames
        if ended:
            raise ended.pop()


@dataclass(frozen=True)
class Direct(Solver):
    """DIRECT (dividing rectangles), as implemented in NLopt."""

    info: ClassVar[SolverInfo] = SolverInfo(
        stochastic=False, reference="Jones, Perttunen & Stuckman 1993, doi:10.1007/BF00941892"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        run(nlopt.GN_DIRECT, problem, rng)


@dataclass(frozen=True)
class DirectL(Solver):
    """DIRECT-L, the locally biased variant of DIRECT, as implemented in NLopt."""

    info: ClassVar[SolverInfo] = SolverInfo(
        stochastic=False, reference="Gablonsky & Kelley 2001, doi:10.1023/A:1017930332101"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        run(nlopt.GN_DIRECT_L, problem, rng)


@dataclass(frozen=True)
class DirectLRand(Solver):
    """DIRECT-L that chooses at random which one to divide if a rectangle has several longest sides."""

    info: ClassVar[SolverInfo] = SolverInfo(
        reference="Gablonsky & Kelley 2001, doi:10.1023/A:1017930332101; Johnson (NLopt)"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        run(nlopt.GN_DIRECT_L_RAND, problem, rng)


@dataclass(frozen=True)
class CRS2LM(Solver):
    """Controlled random search with local mutation, as implemented in NLopt.

    population: number of points kept, at least n + 1 for n unknowns; None: NLopt's default, 10·(n + 1).
    """

    population: Annotated[int, Ge(2)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        accepts_start=True, reference="Kaelo & Ali 2006, doi:10.1007/s10957-006-9101-0"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        least = problem.dimension + 1
        if self.population is not None and self.population < least:
            raise Incompatible(
                f"population: expected at least {least} for {problem.dimension} unknowns, got {self.population}"
            )
        run(nlopt.GN_CRS2_LM, problem, rng, self.population)


@dataclass(frozen=True)
class ISRES(Solver):
    """Improved stochastic ranking evolution strategy, as implemented in NLopt.

    population: number of offspring per generation; None: NLopt's default, 20·(n + 1) for n unknowns.
    """

    population: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        accepts_start=True, reference="Runarsson & Yao 2005, doi:10.1109/TSMCC.2004.841906"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        run(nlopt.GN_ISRES, problem, rng, self.population)


@dataclass(frozen=True)
class ESCH(Solver):
    """Evolution strategy with Cauchy mutation, as implemented in NLopt.

    population: number of parents; a generation has 1.5 times as many offspring; None: NLopt's default, 40.
    """

    population: Annotated[int, Ge(1)] | None = None

    info: ClassVar[SolverInfo] = SolverInfo(
        accepts_start=True,
        converges=False,
        reference="da Silva Santos, Gonçalves & Hernández-Figueroa 2010, IEEE Photonics Tech. Letters 22(15)",
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        run(nlopt.GN_ESCH, problem, rng, self.population)


@dataclass(frozen=True)
class MLSL(Solver):
    """Multi-level single linkage: local searches from low-discrepancy points, ideally one per basin of attraction.

    local: derivative-free algorithm of the local searches. COBYLA is not offered because it evaluates NaN on plateaus.
    population: number of points sampled per round; None: NLopt's default, 4.
    xtol: a local search ends when its steps are smaller than this fraction of the width of the box.
    ftol: a local search ends when a step changes the value by less than this fraction of the value.
    """

    local: Literal["sbplx", "nelder-mead", "bobyqa"] = "sbplx"
    population: Annotated[int, Ge(1)] | None = None
    xtol: Annotated[float, Gt(0.0)] = 1e-8
    ftol: Annotated[float, Ge(0.0)] = 1e-12

    info: ClassVar[SolverInfo] = SolverInfo(
        accepts_start=True,
        reference="Rinnooy Kan & Timmer 1987, doi:10.1007/BF02592071; Kucherenko & Sytsko 2005, "
        "doi:10.1007/s10589-005-4615-1",
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        algorithms = {"sbplx": nlopt.LN_SBPLX, "nelder-mead": nlopt.LN_NELDERMEAD, "bobyqa": nlopt.LN_BOBYQA}
        local = nlopt.opt(algorithms[self.local], problem.dimension)
        local.set_xtol_abs(self.xtol)
        local.set_ftol_rel(self.ftol)
        run(nlopt.G_MLSL_LDS, problem, rng, self.population, local)


@dataclass(frozen=True)
class MLSLLBFGS(Solver):
    """Multi-level single linkage with local searches by L-BFGS, which use the problem's gradient.

    NLopt's L-BFGS may give up in a narrow valley, which also ends MLSL; MLSL is then restarted with random points.

    sampling: starting points of the local searches: "low-discrepancy" for Sobol points, "random" for uniform points as
        in the original paper.
    population: number of points sampled per round; None: NLopt's default, 4.
    xtol: a local search ends when its steps are smaller than this fraction of the width of the box.
    ftol: a local search ends when a step changes the value by less than this fraction of the value.
    """

    sampling: Literal["low-discrepancy", "random"] = "low-discrepancy"
    population: Annotated[int, Ge(1)] | None = None
    xtol: Annotated[float, Gt(0.0)] = 1e-8
    ftol: Annotated[float, Ge(0.0)] = 1e-12

    info: ClassVar[SolverInfo] = SolverInfo(
        accepts_start=True,
        needs_gradient=True,
        reference="Rinnooy Kan & Timmer 1987, doi:10.1007/BF02592071; Kucherenko & Sytsko 2005, "
        "doi:10.1007/s10589-005-4615-1; L-BFGS: Nocedal 1980, doi:10.1090/S0025-5718-1980-0572855-7",
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        local = nlopt.opt(nlopt.LD_LBFGS, problem.dimension)
        local.set_xtol_abs(self.xtol)
        local.set_ftol_rel(self.ftol)
        algorithm = nlopt.G_MLSL_LDS if self.sampling == "low-discrepancy" else nlopt.G_MLSL
        while True:
            try:
                return run(algorithm, problem, rng, self.population, local)
            except nlopt.runtime_error:
                algorithm = nlopt.G_MLSL  # the sequence of Sobol points would be the same again


@dataclass(frozen=True)
class StoGO(Solver):
    """StoGO: branch and bound on boxes, based on whether gradient descents from a box leave it or end in it."""

    info: ClassVar[SolverInfo] = SolverInfo(
        stochastic=False,
        needs_gradient=True,
        reference="Madsen & Zertchaninov 1998, Technical University of Denmark, IMM-REP-1998-04",
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        run(nlopt.GD_STOGO, problem, rng)


@dataclass(frozen=True)
class StoGORand(Solver):
    """StoGO with additional random points in each box."""

    info: ClassVar[SolverInfo] = SolverInfo(
        needs_gradient=True,
        reference="Madsen & Zertchaninov 1998, Technical University of Denmark, IMM-REP-1998-04",
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        run(nlopt.GD_STOGO_RAND, problem, rng)


@dataclass(frozen=True)
class AGS(Solver):
    """Adaptive global search along a space-filling curve, for at most 10 unknowns.

    Its resolution is a grid with a step of 2⁻¹² of the width of the box.
    """

    info: ClassVar[SolverInfo] = SolverInfo(
        stochastic=False, converges=False, reference="Sergeyev & Markin 1995, J. Global Optimization 7(4)"
    )

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        if problem.dimension > AGS_DIMENSIONS:
            raise Incompatible(
                f"nlopt-ags: expected a problem with at most {AGS_DIMENSIONS} unknowns, got {problem.dimension}"
            )
        run(nlopt.GN_AGS, problem, rng)
