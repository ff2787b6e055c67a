"""A delay of the input, in whole samples: tried where a later input explains the log better."""

from __future__ import annotations

import math

import numpy as np

from undeadzone.identification.fit import Fit, climbed, fit_linear
from undeadzone.identification.objective import Objective
from undeadzone.identification.options import MOST_LATE
from undeadzone.identification.orders import OrderFit, best_order
from undeadzone.identification.plant_fit import Data, Simulator
from undeadzone.support.arrays import Floats

PROBES = (0, 1, 2, 3, 5, 7, 10, 14, 19, 25)  # samples
SCREENED = 2  # order of the linear plant
STEPS = 30  # of a climb
ROUGH = 0.3  # rms of what a linear plant leaves, at the start of a climb
NEARLY_ZERO = 0.05  # a sampled pole below it is a delay in disguise
CLEARLY = 20.0  # of BIC, by which a delay must be better than more poles
REACH = 6.0  # of BIC: odds of 20 to 1, within which a delay may be the true one


def delayed(data: Data, samples: int) -> Data:
    """The records with their inputs later; what is not known is held.

    Args:
        data: the records.
        samples: by how many; negative: earlier.
    """
    u = np.empty_like(data.u)
    for part in data.records():
        at = np.arange(part.stop - part.start) - samples
        u[part] = data.u[part][np.clip(at, 0, len(at) - 1)]
    return data._replace(u=u)


def likely_delay(fits: list[OrderFit]) -> int:
    """The delay with which a linear plant of low order explains a log best.

    The zone disturbs these fits much alike; whether the delay is real is decided by fits with it.

    Args:
        fits: one an order, without a delay.

    Returns:
        Samples; 0 where none is better.
    """
    objective = fits[0].pairs.objective
    data, integrators = objective.data, objective.layout.integrators
    order = max(SCREENED, integrators + 1)
    left: dict[int, float] = {}

    def scan(samples: int) -> float:
        if samples not in left:
            fit = fit_linear(Simulator(delayed(data, samples), order, integrators))
            left[samples] = fit.s
        return left[samples]

    best = min(PROBES, key=scan)
    while True:  # to the least next to it
        near = min((max(best - 1, 0), best, best + 1), key=scan)
        if near == best:
            return best
        best = near


def better_delay(fits: list[OrderFit], late: list[OrderFit]) -> bool:
    """Whether fits with a delay are better by BIC; the delay counts as a number.

    Clearly better, where the poles without it are those of a plant in continuous time.

    Args:
        fits: one an order, without a delay.
        late: with it.
    """
    best = best_order(fits)
    margin = math.log(float(fits[0].pairs.objective.readings.ok.sum()))
    if _is_sampled(best.pairs):
        margin += CLEARLY  # a fast pole looks much like a delay
    return best_order(late).pairs.bic + margin < best.pairs.bic


def _is_sampled(fit: Fit) -> bool:
    """Whether a plant in continuous time has these poles: none at 0 nearly, none negative."""
    poles = fit.objective.simulator.poles(fit.theta)
    real = np.abs(poles.imag) < 1e-9
    return bool(np.all(np.where(real, poles.real, np.abs(poles)) > NEARLY_ZERO))


def refined_delay(late: list[OrderFit], samples: int) -> int:
    """By how many samples the input acts late, by BIC: as far from a delay as it gets better.

    Args:
        late: fits with a delay, one an order.
        samples: the delay.
    """
    best = best_order(late)
    smaller = [one.pairs for one in late if one.n <= best.n][-2:]
    known = {samples: best.pairs.bic}
    for direction in (-1, 1):
        trial = samples + direction
        while 0 <= trial <= MOST_LATE:
            known[trial] = min(_late(fit, trial - samples).bic for fit in smaller)
            if known[trial] >= known[trial - direction]:
                break
            trial += direction
    return min(known, key=lambda trial: known[trial])


def alike(fits: list[OrderFit], late: list[OrderFit]) -> list[OrderFit]:
    """What explains a log as well as its best fit, or nearly: the best fit with a delay, or none.

    Args:
        fits: those that were chosen, one an order.
        late: those with the delay that was not.
    """
    other = best_order(late)
    return [other] if other.pairs.bic < best_order(fits).pairs.bic + REACH else []


def later(fits: list[OrderFit], samples: int) -> list[OrderFit]:
    """Fits with the input later, from where they ended; their checks are those of before.

    Args:
        fits: one an order.
        samples: by how many.
    """
    moved = []
    for one in fits:
        singles = _late(one.singles, samples)
        pairs = singles if one.pairs is one.singles else _late(one.pairs, samples)
        moved.append(one._replace(singles=singles, pairs=pairs))
    return moved


def _late(fit: Fit, samples: int) -> Fit:
    """A fit with the input later, from two starts.

    One has the numerators with which z is nearest to what it was, the other the linear plant.
    """
    old = fit.objective
    simulator = Simulator(delayed(old.data, samples), old.layout.n, old.layout.integrators)
    objective = Objective(simulator, old.kind, old.limits)
    begun = [_near(fit, simulator), _linear(fit, simulator)]
    top = max((climbed(objective, theta, STEPS) for theta in begun), key=lambda one: one.value)
    return Fit(objective, top.theta, top.value)


def _near(fit: Fit, simulator: Simulator) -> Floats:
    """The poles of a fit, and numerators with which z is nearest to what it was."""
    layout = simulator.layout
    linear = slice(layout.b.start, layout.x0.stop)  # z is linear in b and x(0)
    columns = simulator.gradient(fit.theta, fit.z)[:, linear]
    theta = fit.theta.copy()
    theta[linear] = np.linalg.lstsq(columns, fit.z, rcond=1e-10)[0]
    missed = float(np.mean((columns @ theta[linear] - fit.z) ** 2))
    theta[layout.right + 2] = 0.5 * math.log(fit.s**2 + missed)
    return theta


def _linear(fit: Fit, simulator: Simulator) -> Floats:
    """The widths of a fit, and the linear plant with the gain that these take away."""
    layout = simulator.layout
    theta = fit.theta.copy()
    plant = fit_linear(simulator).theta
    theta[: layout.right] = plant[: layout.right]
    theta[layout.b] *= float(fit.z.std() / simulator.z(plant).std())
    theta[layout.right + 2] = math.log(ROUGH)
    return theta
