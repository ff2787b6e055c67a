"""One record of several."""

from __future__ import annotations

import numpy as np

from undeadzone.identification.fit import Fit, refit
from undeadzone.identification.objective import Objective
from undeadzone.identification.plant_fit import Simulator


def longest_record(fit: Fit) -> Fit:
    """The fit of the longest of several records alone, from where that of all ended.

    Args:
        fit: of one or several records.
    """
    old = fit.objective
    records = old.data.records()
    if len(records) == 1:
        return fit
    sizes = [part.stop - part.start for part in records]
    which = int(np.argmax(sizes))
    part = records[which]
    data = old.data._replace(
        u=old.data.u[part],
        y=old.data.y[part],
        ok=old.data.ok[part],
        side=old.data.side[part],
        start=np.zeros(1, int),
    )
    simulator = Simulator(data, old.layout.n, old.layout.integrators)
    objective = Objective(simulator, old.kind, old.limits)
    n, first = old.layout.n, old.layout.x0.start
    own = fit.theta[first + n * which : first + n * (which + 1)]
    theta = np.concatenate([fit.theta[:first], own, fit.theta[old.layout.right :]])
    return refit(Fit(objective, theta, objective.value(theta)), old.kind)
