"""
Each run predicted from the others
==================================

A surrogate that predicts left-out runs well near the mode can be trusted there.
"""

import numpy as np

import strandline as sl
from strandline.report.plots import plot_leave_one_out

study = sl.load_study("../studies/biofilm")
with sl.Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
    runs = [record for record in ledger if record.ok]
x = np.array([[run.inputs[name] for name in study.space.names] for run in runs])
observed = study.model({"E": 400.0, "nu": 0.3, "V_in": 100.0}).interface
norm = sl.Currents(0.005)
values = np.array([-0.5 * norm(run.interface, observed) / 0.0005 for run in runs])
left_out = sl.fit_log_likelihood(x, values).validation
plot_leave_one_out(values, values - left_out.residuals, near_mode=left_out.near_mode)
