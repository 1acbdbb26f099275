"""The linear solvers on coupled Jacobians of the coarse mesh: SciPy's SuperLU solves the same equations."""

import ctypes
import gc
from collections.abc import Callable, Iterator
from importlib import metadata

import numpy as np
import pytest
import scipy.sparse
from ngsolve import la
from scipy.sparse.linalg import spsolve

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm import linear
from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.linear import SOLVERS, Factorisation, linear_solver
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition

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
    reference = Outline().interface()
    cell = FlowCell(
        reference, MESHES["coarse"], channel=Channel(), partition=Partition(), law=LAWS["saint_venant_kirchhoff"]
    )
    found = {}
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
        entries_of(matrix)[:] = jacobian.data
        expected = spsolve(jacobian.tocsc(), right, use_umfpack=False)
        error = Factorisation(matrix, matrix.height).solve(right) - expected
        assert np.linalg.norm(error) < 1e-8 * np.linalg.norm(expected)


def test_jacobian_is_unsymmetric_so_that_a_symmetric_solver_would_show(jacobians):
    jacobian = jacobians[0.3]
    assert abs(jacobian - jacobian.T).max() > 0.1 * abs(jacobian).max()


def test_factorisation_outlives_a_change_of_its_matrix(solver, jacobians):
    matrix = ngsolve_matrix(jacobians[0.3])
    right = np.random.default_rng(2).standard_normal(matrix.height)
    first = Factorisation(matrix, matrix.height)
    before = first.solve(right)
    entries_of(matrix)[:] = jacobians[0.0].data
    second = Factorisation(matrix, matrix.height)
    assert np.abs(second.solve(right) - before).max() > 1e-3 * np.abs(before).max()
    np.testing.assert_allclose(first.solve(right), before, rtol=1e-9, atol=1e-9 * np.abs(before).max())


@pytest.mark.parametrize(
    "values", [(1.0, 2.0, 2.0, 4.0), (0.0, 0.0, 0.0, 0.0), (np.nan, 1.0, 1.0, 2.0)], ids=["rank 1", "zero", "nan"]
)
def test_singular_matrix_is_a_failure_of_the_linear_solve_and_prints_nothing(solver, values, capfd):
    with pytest.raises(ForwardModelError) as caught:
        Factorisation(small(*values), 2).solve(np.array([1.0, 0.0]))
    assert caught.value.kind == "linear_solve"
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


def test_right_hand_side_that_is_not_finite_is_a_failure_of_the_linear_solve(solver):
    with pytest.raises(ForwardModelError, match="linear_solve"):
        Factorisation(small(1.0, 2.0, 3.0, 4.0), 2).solve(np.array([np.inf, 0.0]))


@pytest.mark.parametrize("name", ["sparsecholesky", "UMFPACK", ""])
def test_environment_with_an_unknown_solver_is_refused(choose, name):
    choose(name)
    with pytest.raises(InvalidInput, match=linear.VARIABLE):
        linear_solver()
    with pytest.raises(InvalidInput, match=linear.VARIABLE):
        Biofilm()


def test_choice_is_made_once_per_process(choose, monkeypatch):
    choose("umfpack")
    assert linear_solver() == "umfpack"
    monkeypatch.setenv(linear.VARIABLE, "nonsense")
    assert linear_solver() == "umfpack"


@pytest.mark.parametrize("works", [True, False])
def test_pardiso_is_taken_where_it_works(choose, monkeypatch, works):
    monkeypatch.setattr(linear, "_pardiso_works", lambda: works)
    choose(None)
    assert linear_solver() == ("pardiso" if works else "umfpack")
    choose("umfpack")
    assert linear_solver() == "umfpack"


def test_pardiso_asked_for_and_not_there_is_refused_with_the_remedy(choose, monkeypatch):
    monkeypatch.setattr(linear, "_pardiso_works", lambda: False)
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
    from strandline.models.biofilm.model import _flow_cell

    runs = {}
    for name, poissons in (("pardiso", (0.3, 0.5, -0.6)), ("pardiso again", (-0.6, 0.5, 0.3)), ("umfpack", (0.3, 0.5))):
        choose(name.split()[0])
        _flow_cell.cache_clear()
        for poisson in poissons:
            points = Biofilm(mesh="coarse")({"E": 500.0, "nu": poisson, "V_in": 100.0}).interfaces[""].points
            runs[name, poisson] = np.array(points)
    _flow_cell.cache_clear()
    for poisson in (0.3, 0.5, -0.6):
        np.testing.assert_array_equal(runs["pardiso", poisson], runs["pardiso again", poisson])
    for poisson in (0.3, 0.5):
        np.testing.assert_allclose(runs["pardiso", poisson], runs["umfpack", poisson], rtol=0, atol=1e-9)
