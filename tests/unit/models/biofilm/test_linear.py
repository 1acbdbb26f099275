"""The linear solvers on coupled Jacobians: SciPy's SuperLU solves the same equations."""

import ctypes
import gc
from collections.abc import Callable, Iterator
from importlib import metadata

import numpy as np
import pytest
import scipy.sparse
from ngsolve import la
from scipy.sparse.linalg import spsolve
from tests.unit.models.biofilm.cells import rough, rough_cell

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm import linear
from strandline.models.biofilm.linear import SOLVERS, Factorisation, linear_solver
from strandline.models.biofilm.model import Biofilm, _flow_cell

NEEDS_MKL = "the package mkl, which brings PARDISO, is not installed"
HAS_MKL = any(d.name.lower() == "mkl" for d in metadata.distributions())


@pytest.fixture
def choose(monkeypatch) -> Iterator[Callable[[str | None], None]]:
    def chosen(name: str | None) -> None:
        monkeypatch.delenv(linear.VARIABLE, raising=False) if name is None else monkeypatch.setenv(
            linear.VARIABLE, name
        )
        linear_solver.cache_clear()

    yield chosen
    linear_solver.cache_clear()


@pytest.fixture(
    params=[
        pytest.param(s, marks=pytest.mark.skipif(s == "pardiso" and not HAS_MKL, reason=NEEDS_MKL)) for s in SOLVERS
    ]
)
def solver(request, choose) -> str:
    choose(request.param)
    return request.param


@pytest.fixture(scope="module")
def jacobians() -> dict[float, scipy.sparse.csr_array]:
    """Jacobians of one cell at the flow past the rigid body, by Poisson's ratio; 0.3 comes first."""
    cell, found = rough_cell(), {}
    for poisson in (0.3, 0.0, -0.8, 0.4999, 0.5):
        cell.system.set_material([40.0], [poisson])
        cell.residual(cell.rigid_flow, 1.0)
        matrix = cell.system._pattern.fill(cell.system._assemble())
        values, columns, pointers = (np.array(a) for a in matrix.CSR())
        found[poisson] = scipy.sparse.csr_array((values, columns, pointers.astype(np.int32)))
    return found


def ngsolve_matrix(values: scipy.sparse.csr_array) -> object:
    entries = values.tocoo()
    rows, columns = (index.tolist() for index in entries.coords)
    return la.SparseMatrixd.CreateFromCOO(rows, columns, entries.data.tolist(), *values.shape)


def entries_of(matrix) -> np.ndarray:
    return matrix.AsVector().FV().NumPy()


def small(*values: float) -> object:
    return la.SparseMatrixd.CreateFromCOO([0, 0, 1, 1], [0, 1, 0, 1], list(values), 2, 2)


def test_solutions_agree_with_superlu_one_matrix_after_the_other(solver, jacobians):
    """At ν = 0.5 the analysis kept from 0.3 does not suit: unchecked, PARDISO's error is beyond all measure."""
    matrix = ngsolve_matrix(jacobians[0.3])
    right = np.random.default_rng(1).standard_normal(matrix.height)
    for jacobian in jacobians.values():
        assert abs(jacobian - jacobian.T).max() > 0.1 * abs(jacobian).max()  # a symmetric solver would show
        entries_of(matrix)[:] = jacobian.data
        expected = spsolve(jacobian.tocsc(), right, use_umfpack=False)
        error = Factorisation(matrix, matrix.height).solve(right) - expected
        assert np.linalg.norm(error) < 1e-8 * np.linalg.norm(expected)


def test_factorisation_outlives_a_change_of_its_matrix(solver, jacobians):
    matrix = ngsolve_matrix(jacobians[0.3])
    right = np.random.default_rng(2).standard_normal(matrix.height)
    first = Factorisation(matrix, matrix.height)
    before = first.solve(right)
    entries_of(matrix)[:] = jacobians[0.0].data
    second = Factorisation(matrix, matrix.height)
    assert np.abs(second.solve(right) - before).max() > 1e-3 * np.abs(before).max()
    np.testing.assert_allclose(first.solve(right), before, rtol=1e-9, atol=1e-9 * np.abs(before).max())


def test_what_has_no_solution_is_a_failure_of_the_linear_solve_and_prints_nothing(solver, capfd):
    for values in ((1.0, 2.0, 2.0, 4.0), (0.0, 0.0, 0.0, 0.0), (np.nan, 1.0, 1.0, 2.0)):
        with pytest.raises(ForwardModelError, match="linear_solve"):
            Factorisation(small(*values), 2).solve(np.array([1.0, 0.0]))
    with pytest.raises(ForwardModelError, match="linear_solve"):
        Factorisation(small(1.0, 2.0, 3.0, 4.0), 2).solve(np.array([np.inf, 0.0]))
    ctypes.CDLL(None).fflush(None)
    print("afterwards")
    assert capfd.readouterr() == ("afterwards\n", "")


def test_jacobian_without_a_row_or_column_is_a_failure_of_the_linear_solve(solver, jacobians):
    jacobian = jacobians[0.3]
    rows = np.repeat(np.arange(jacobian.shape[0]), np.diff(jacobian.indptr))
    matrix = ngsolve_matrix(jacobian)
    right = np.random.default_rng(3).standard_normal(matrix.height)
    for gone in (rows == 100, jacobian.indices == 100):
        entries_of(matrix)[:] = np.where(gone, 0.0, jacobian.data)
        with pytest.raises(ForwardModelError, match="linear_solve"):
            Factorisation(matrix, matrix.height).solve(right)
    entries_of(matrix)[:] = jacobian.data
    expected = spsolve(jacobian.tocsc(), right, use_umfpack=False)
    after = Factorisation(matrix, matrix.height).solve(right)
    np.testing.assert_allclose(after, expected, atol=1e-8 * np.abs(expected).max(), rtol=0)


def test_the_solver_is_chosen_once_by_the_environment_or_by_what_works(choose, monkeypatch):
    for name in ("sparsecholesky", "UMFPACK", ""):
        choose(name)
        for asking in (linear_solver, Biofilm):
            with pytest.raises(InvalidInput, match=linear.VARIABLE):
                asking()
    choose("umfpack")
    assert linear_solver() == "umfpack"
    monkeypatch.setenv(linear.VARIABLE, "nonsense")
    assert linear_solver() == "umfpack"
    for works in (True, False):
        monkeypatch.setattr(linear, "_pardiso_works", lambda works=works: works)
        choose(None)
        assert linear_solver() == ("pardiso" if works else "umfpack")
    choose("pardiso")
    with pytest.raises(InvalidInput, match=r"strandline\[mkl\]"):
        linear_solver()


@pytest.mark.skipif(not HAS_MKL, reason=NEEDS_MKL)
def test_pardiso_is_found_where_mkl_is_installed(choose):
    choose(None)
    assert linear_solver() == "pardiso"


@pytest.mark.skipif(not HAS_MKL, reason=NEEDS_MKL)
def test_analysis_is_kept_and_goes_with_its_matrix(choose, jacobians):
    choose("pardiso")
    gc.collect()
    before = len(linear._analyses)
    matrix = ngsolve_matrix(jacobians[0.3])
    held = [Factorisation(matrix, matrix.height) for _ in range(3)]
    assert len(linear._analyses) == before + 1
    del matrix, held
    gc.collect()
    assert len(linear._analyses) == before


@pytest.mark.skipif(not HAS_MKL, reason=NEEDS_MKL)
def test_runs_by_pardiso_do_not_depend_on_those_before_and_agree_with_umfpack(choose):
    """Bitwise, with ν = 0.5 in between, for which the analysis is renewed."""
    points = {}
    for name, poissons in (("pardiso", (0.3, 0.5, -0.6)), ("pardiso again", (-0.6, 0.5, 0.3)), ("umfpack", (0.3, 0.5))):
        choose(name.split()[0])
        _flow_cell.cache_clear()
        model = rough()
        points |= {(name, nu): model({"E": 500.0, "nu": nu, "V_in": 100.0}).interface.points for nu in poissons}
    _flow_cell.cache_clear()
    for poisson in (0.3, 0.5, -0.6):
        np.testing.assert_array_equal(points["pardiso", poisson], points["pardiso again", poisson])
    for poisson in (0.3, 0.5):
        np.testing.assert_allclose(points["pardiso", poisson], points["umfpack", poisson], rtol=0, atol=1e-9)
