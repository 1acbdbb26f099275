"""Figures of several models: what they draw is what they were given."""

import numpy as np

from strandline.report import plots

EDGES = np.linspace(0.0, 2.0, 5)


def marginals(label: str) -> plots.ModelMarginals:
    densities = {"a": np.array([1.0, 1.0, 0.0, 0.0]), "b_c$": np.array([0.0, 0.0, 1.0, 1.0])}
    return plots.ModelMarginals(label, "Pa", EDGES, np.full(4, 0.5), densities)


def test_marginals_are_steps_of_each_model_and_of_the_average() -> None:
    ax = plots.plot_model_marginals(marginals("E"))
    drawn = {patch.get_label(): patch.get_data() for patch in ax.patches}
    assert list(drawn) == ["a", r"b_c\$", "averaged"]
    np.testing.assert_array_equal(drawn["a"].values, [1.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(drawn["averaged"].edges, EDGES)
    assert "Pa" in ax.get_xlabel()


def test_inputs_fill_rows_of_three() -> None:
    figure = plots.plot_averaged({str(k): marginals(f"E{k}") for k in range(4)})
    assert len(figure.axes) == 4
    assert len(figure.legends) == 1


def band(shift: float) -> plots.OffsetBand:
    s = np.linspace(0.0, 1.0, 6)
    return plots.OffsetBand(s, np.full(6, -0.001), np.zeros(6), np.full(6, 0.001), s, np.full(6, float(shift)))


def test_predictions_have_a_row_for_each_condition_and_a_column_for_each_model() -> None:
    bands = {(condition, name): band(k) for k, name in enumerate("ab") for condition in ("slow", "fast")}
    figure = plots.plot_predictions(bands)
    assert [ax.get_title() for ax in figure.axes] == ["a, slow", "b, slow", "a, fast", "b, fast"]
    observed = [float(ax.lines[-1].get_ydata()[0]) for ax in figure.axes]
    assert observed == [0.0, 1e3, 0.0, 1e3], "in micrometres"
    assert plots.plot_predictions({("", "a"): band(0.0)}).axes[0].get_title() == "a"
