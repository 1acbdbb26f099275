"""The enlarged detail of a narrow likelihood."""

from dataclasses import replace

import numpy as np

from strandline.parameters import Parameter
from strandline.priors import Uniform
from strandline.report.plots import FieldGrid, plot_field

INSET_PARAMETERS = (Parameter("a", Uniform(0.0, 1.0)), Parameter("b", Uniform(0.0, 1.0)))


def test_narrow_likelihood_is_shown_enlarged_on_one_scale():
    whole = FieldGrid(*INSET_PARAMETERS, np.linspace(0, 1, 11), np.linspace(0, 1, 11), np.full((11, 11), -3.0))
    part = FieldGrid(*INSET_PARAMETERS, np.linspace(0.4, 0.5, 9), np.linspace(0.4, 0.5, 9), np.zeros((9, 9)))
    ax = plot_field(replace(whole, detail=replace(part, truth=np.array([0.45, 0.45]))), kind="likelihood")
    (inset,) = ax.child_axes
    main, enlarged = (a.collections[0].get_array() for a in (ax, inset))
    np.testing.assert_allclose(main, np.exp(-3.0))
    np.testing.assert_allclose(enlarged, 1.0)
    assert "ground truth" in ax.get_legend_handles_labels()[1]
    assert not plot_field(replace(whole, detail=part), kind="log_likelihood").child_axes
