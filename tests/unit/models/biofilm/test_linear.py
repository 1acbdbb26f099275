"""The linear solvers on coupled Jacobians: SciPy's SuperLU solves the same equations."""

import ctypes
from importlib import metadata

import numpy as np
import pytest
import scipy.sparse
from ngsolve import la
from scipy.sparse.linalg import spsolve
from tests.unit.models.biofilm.cells import rough, rough_cell

from strandline.foundations import ForwardModelError, InvalidInput
from strandline.models.biofilm import linear
from strandline.models.biofilm.linear import SOLVERS, Factorisation, linear_solver
from strandline.models.biofilm.model import Biofilm, _flow_cell

needs_mkl = pytest.mark.skipif(
    not any(one.name.lower() == "mkl" for one in metadata.distributions()),
    reason="the package mkl, which brings PARDISO, is not installed",
)


@pytest.fixture
def choose(monkeypatch):
    def chosen(name):
        monkeypatch.setenv(linear.VARIABLE, name)
        linear_solver.cache_clear()

    yield chosen
    linear_solver.cache_clear()


@pytest.fixture(params=[pytest.param(name, marks=needs_mkl) if name == "pardiso" else name for name in SOLVERS])
def solver(request, choose):
    choose(request.param)


@pytest.fixture(scope="module")
def jacobians():
    """Jacobians of one cell at the flow past the rigid body, by Poisson's ratio; 0.3 comes first."""
    cell, found = rough_cell(), {}
    for poisson in (0.3, 0.0, -0.8, 0.4999, 0.5):
        cell.system.set_material([40.0], [poisson])
        cell.residual(cell.rigid_flow, 1.0)
        matrix = cell.system._pattern.fill(cell.system._assemble())
        values, columns, pointers = (np.array(a) for a in matrix.CSR())
        found[poisson] = scipy.sparse.csr_array((values, columns, pointers.astype(np.int32)))
    return found


def ngsolve_matrix(values):
    entries = values.tocoo()
    rows, columns = (index.tolist() for index in entries.coords)
    return la.SparseMatrixd.CreateFromCOO(rows, columns, entries.data.tolist(), *values.shape)


def error_of(jacobian, matrix, right):
    """Return the largest error of a solution, as a share of SuperLU's largest entry."""
    matrix.AsVector().FV().NumPy()[:] = jacobian.data
    expected = spsolve(jacobian.tocsc(), right, use_umfpack=False)
    return np.abs(Factorisation(matrix, matrix.height).solve(right) - expected).max() / np.abs(expected).max()


def error_of_transposed(jacobian, matrix, rights):
    """Do the same with the transpose and several right-hand sides, which need not be contiguous."""
    matrix.AsVector().FV().NumPy()[:] = jacobian.data
    expected = spsolve(jacobian.T.tocsc(), rights.T, use_umfpack=False).T
    factorised = Factorisation(matrix, matrix.height)
    before = factorised.solve(rights[0])
    found = factorised.solve_transposed(np.asfortranarray(rights))
    np.testing.assert_array_equal(factorised.solve(rights[0]), before)
    return np.abs(found - expected).max() / np.abs(expected).max()


def test_solutions_agree_with_superlu_one_matrix_after_the_other(solver, jacobians):
    """At ν = 0.5 the analysis kept from 0.3 does not suit: unchecked, PARDISO's error is beyond all measure."""
    matrix = ngsolve_matrix(jacobians[0.3])
    right = np.random.default_rng(1).standard_normal(matrix.height)
    for jacobian in jacobians.values():
        assert abs(jacobian - jacobian.T).max() > 0.1 * abs(jacobian).max()  # a symmetric solver would show
        assert error_of(jacobian, matrix, right) < 1e-8


def test_transposed_solutions_agree_with_superlu_and_leave_the_solver_as_it_was(solver, jacobians, monkeypatch):
    monkeypatch.setattr(linear, "AT_ONCE", 3)
    matrix = ngsolve_matrix(jacobians[0.3])
    rights = np.random.default_rng(1).standard_normal((5, matrix.height))
    for poisson in (0.3, 0.5, -0.8):
        assert error_of_transposed(jacobians[poisson], matrix, rights) < 1e-8
        assert error_of_transposed(jacobians[poisson], matrix, rights[:1]) < 1e-8
        assert error_of(jacobians[poisson], matrix, rights[0]) < 1e-8


def test_what_has_no_solution_is_a_failure_of_the_linear_solve_and_prints_nothing(solver, jacobians, capfd):
    """Without a row, without a column, zero, not finite; with a right-hand side that is not finite."""
    jacobian = jacobians[0.3]
    rows = np.repeat(np.arange(jacobian.shape[0]), np.diff(jacobian.indptr))
    matrix = ngsolve_matrix(jacobian)
    right = np.random.default_rng(3).standard_normal(matrix.height)
    for factor in (rows != 100, jacobian.indices != 100, 0.0, np.where(rows == 100, np.nan, 1.0)):
        matrix.AsVector().FV().NumPy()[:] = factor * jacobian.data
        with pytest.raises(ForwardModelError, match="linear_solve"):
            Factorisation(matrix, matrix.height).solve(right)
    assert error_of(jacobian, matrix, right) < 1e-8
    with pytest.raises(ForwardModelError, match="linear_solve"):
        Factorisation(matrix, matrix.height).solve(np.full(matrix.height, np.inf))
    singular = ngsolve_matrix(scipy.sparse.csr_array([[1.0, 2.0], [2.0, 4.0]]))
    with pytest.raises(ForwardModelError, match="linear_solve"):
        Factorisation(singular, 2).solve(np.array([1.0, 0.0]))
    ctypes.CDLL(None).fflush(None)
    print("afterwards")
    assert capfd.readouterr() == ("afterwards\n", "")


def test_the_solver_is_chosen_by_the_environment_or_by_what_works(choose, monkeypatch):
    choose("UMFPACK")
    with pytest.raises(InvalidInput, match=linear.VARIABLE):
        Biofilm()
    monkeypatch.delenv(linear.VARIABLE)
    for works, expected in ((True, "pardiso"), (False, "umfpack")):
        monkeypatch.setattr(linear, "_pardiso_works", lambda works=works: works)
        linear_solver.cache_clear()
        assert linear_solver() == expected
    choose("pardiso")
    with pytest.raises(InvalidInput, match=r"strandline\[mkl\]"):
        linear_solver()


@needs_mkl
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
