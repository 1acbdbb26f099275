"""What changes are made, and what is left alone."""

import ast

import pytest
from verification.mutation.operators import mutants

SOURCE = '''
"""Text with β."""
SETTING = 0.05


def shift(α: "Float[np.ndarray, ' 3']", β: float = 2.0) -> float:
    """Return α - β."""
    if β < 0:
        raise ValueError(f"β is {β + 1}, not positive")
    if not α:
        return 0.0
    α = α - β
    return max(α / β, -SETTING)
'''


def changes(source: str) -> set[tuple[str, str]]:
    return {(one.before, one.after) for place in mutants(source) for one in place}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("α - β", "(α + β)"),
        ("α - β", "(β - α)"),
        ("α - β", "(α)"),
        ("α = α - β", "pass"),
        ("not α", "(False)"),
        ("not α", "(α)"),
        ("max(α / β, -SETTING)", "(min(α / β, -SETTING))"),
        ("-SETTING", "(SETTING)"),
        ("α / β", "(α * β)"),
        ("β < 0", "(β >= 0)"),
    ],
)
def test_mistakes_are_made(before: str, after: str) -> None:
    assert (before, after) in changes(SOURCE)


def test_messages_settings_and_annotations_stay() -> None:
    found = {before for before, _ in changes(SOURCE)}
    assert not found & {"0.05", "2.0", "β + 1", "3"}
    assert ("β < 0", "(False)") not in changes(SOURCE)


def test_each_mutant_is_a_program_with_one_change() -> None:
    for place in mutants(SOURCE):
        for one in place:
            changed = one.applied(SOURCE)
            ast.parse(changed)
            before, after = SOURCE.encode(), changed.encode()
            assert changed != SOURCE
            assert after[: one.start] == before[: one.start]
            assert after.endswith(before[one.end :])
            assert SOURCE.encode()[: one.start].count(b"\n") + 1 == one.line


@pytest.mark.parametrize("text", ["'a' + name", "f'{a + b}'", "np.sum(x, axis=0)[1]"])
def test_texts_and_axes_stay(text: str) -> None:
    found = changes(f"def f(a, b, x, name):\n    return {text}\n")
    assert not {one for one in found if one[0] in ("'a' + name", "a + b", "0", "1")}
