"""What changes are made, and what is left alone."""

import ast

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
MADE = {
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
}


def changes(source: str) -> set[tuple[str, str]]:
    return {(one.before, one.after) for place in mutants(source) for one in place}


def test_mistakes_are_made_but_messages_settings_texts_and_axes_stay() -> None:
    found = changes(SOURCE)
    assert found >= MADE
    assert not {before for before, _ in found} & {"0.05", "2.0", "β + 1", "3"}
    assert ("β < 0", "(False)") not in found
    for text in ("'a' + name", "f'{a + b}'", "np.sum(x, axis=0)[1]"):
        of_text = changes(f"def f(a, b, x, name):\n    return {text}\n")
        assert not {before for before, _ in of_text} & {"'a' + name", "a + b", "0", "1"}


def test_each_mutant_is_a_program_with_one_change() -> None:
    for one in (one for place in mutants(SOURCE) for one in place):
        changed = one.applied(SOURCE)
        ast.parse(changed)
        before, after = SOURCE.encode(), changed.encode()
        assert changed != SOURCE
        assert after[: one.start] == before[: one.start]
        assert after.endswith(before[one.end :])
        assert before[: one.start].count(b"\n") + 1 == one.line
