"""Numbers of a scenario bound to the lanes of a likelihood, along logs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.compile.lanes import Kernel, build_kernel, run_lanes
from undeadzone.errors import InputError
from undeadzone.nonlinearities.actuator import resolve_actuator
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants import build as plants
from undeadzone.plants.system import System, plant_pace, sample_plant
from undeadzone.scenario.address import stem, with_numbers, with_value
from undeadzone.scenario.encoders import resolve_sensor
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.packed import BoundNumbers, ResampledPlant, bind_numbers
from undeadzone.util import tree
from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.fitting.free import WIDTHS, FreeNumber
from undeadzone_identify.fitting.likelihood import OPEN, RECORDED, FilterNumbers, build_step

SURE: Final = 4.0  # noise, in its rms, beyond which a reading is surely active
KNOWN: Final = 1e-7  # deviation of a number of x(0) that is known
LOST: Final = -1e4  # log density of a reading along which a lane has diverged
ROOM: Final = 2**23  # numbers that are recorded at once
KINDS: Final = ("deadzone", "jump", "gears")


class Log(NamedTuple):
    """Log along which a likelihood is computed.

    Attributes:
        name: for messages.
        t: times (N) [s].
        y: readings (N x p), NaN if one is missing.
        u: inputs (N x m).
        side: 1 or -1 where a reading surely is active, else 0 (N x p).
    """

    name: str
    t: Floats
    y: Floats
    u: Floats
    side: Floats


def join_logs(logs: Sequence[Log]) -> Log:
    """Return logs joined in their order."""
    return Log("", *map(np.concatenate, zip(*(each[1:] for each in logs), strict=True)))


class Recorded(NamedTuple):
    """Records of lanes along all logs.

    Attributes:
        density: log density of each reading (lanes x N x p).
        prediction: of each reading on its piece (lanes x N x p).
        log_std: log of its deviation (lanes x N x p).
    """

    density: Floats
    prediction: Floats
    log_std: Floats


class FitProblem(NamedTuple):
    """Free numbers of a scenario and the logs that show them.

    Attributes:
        scenario: with its numbers as they are.
        model: the sampled plant.
        zone: the sensor.
        kind: of the characteristic, as `list_pieces` takes it.
        free: numbers that are fitted.
        built: places among them of those for which the plant is built anew.
        slots: slices of the packed numbers of a lane.
        kernel: the compiled filter.
        bound: numbers bound to its lanes, but for x(0).
        logs: the logs.
        whole: all of them, one after the other.
        spread: deviations of x(0) (n).
        is_log: whether the coordinate of a number is its logarithm (k).
        low, high, start: ends of the ranges and first values, in coordinates (k).
        prior_std: deviations of the normal priors of coordinates (k) (inf: there is none).
        threads: of the lanes.
    """

    scenario: Scenario
    model: System
    zone: Zone
    kind: str
    free: tuple[FreeNumber, ...]
    built: tuple[int, ...]
    slots: FilterNumbers
    kernel: Kernel
    bound: BoundNumbers
    logs: tuple[Log, ...]
    whole: Log
    spread: Floats
    is_log: Flags
    low: Floats
    high: Floats
    start: Floats
    prior_std: Floats
    threads: int | None = None

    @property
    def span(self) -> Floats:
        """Return the sizes of the ranges, in coordinates (k)."""
        return self.high - self.low

    def decode_points(self, points: Floats) -> Floats:
        """Return the values of coordinates (lanes x numbers)."""
        return np.exp(points, out=points.copy(), where=self.is_log)

    def to_lanes(self, points: Floats, heat: Any, log: int) -> Any:
        """Return states and params of lanes at coordinates, along one log.

        Args:
            points: coordinates (lanes x numbers).
            heat: further noise ahead of the zone [z] and further disturbance [u].
            log: number of the log.
        """
        values = self.decode_points(points)
        bound = self.bound
        lanes = bound.to_lanes(values, self._compute_plants(values))
        params = np.tile(bound.params, (len(points), 1))
        params[:, bound.indices] = lanes.params
        params[:, self.slots.heat_before] = heat[0]
        params[:, self.slots.heat_rms] = heat[1]
        n, m = self.model.n, self.model.m
        states = lanes.states
        if len(bound.slots) < len(self.free):
            first = len(bound.slots) + log * n
            states[:, :n] = values[:, first : first + n]
        rms = np.hypot(params[:, self.slots.rms], heat[1])
        diagonal = n + m + np.arange(n + m) * np.arange(3, n + m + 3) // 2
        states[:, diagonal[:n]] = self.spread**2
        states[:, diagonal[n:]] = rms**2
        return states, params

    def record_lanes(self, points: Floats, heat: Any = (0.0, 0.0)) -> Recorded:
        """Return the records of lanes at coordinates along all logs."""
        p = self.model.p
        parts = []
        for k, record in enumerate(self.logs):
            states, params = self.to_lanes(points, heat, k)
            w = np.hstack([record.y, record.u, record.side])
            found, _ = run_lanes(
                self.kernel, states, w, params[0], lane_params=params, threads=self.threads
            )
            parts.append(found.reshape(len(points), len(w), p, RECORDED))
        every = np.concatenate(parts, axis=1)
        density = np.nan_to_num(every[..., 0], nan=LOST, posinf=LOST, neginf=LOST)
        return Recorded(np.maximum(density, LOST), every[..., 1], every[..., 2])

    def evaluate_points(self, points: Floats, heat: Any = (0.0, 0.0)) -> Floats:
        """Return the log likelihood with the prior at coordinates (lanes)."""
        rows = max(1, ROOM // (RECORDED * self.whole.y.size))
        parts = np.split(points, range(rows, len(points), rows))
        sums = [self.weigh_logs(part, heat).sum(axis=1) for part in parts]
        return np.concatenate(sums) + self.log_prior(points)

    def weigh_logs(self, points: Floats, heat: Any) -> Floats:
        """Return the log likelihood of each log at coordinates (lanes x logs)."""
        starts = np.cumsum([0, *(len(each.t) for each in self.logs[:-1])])
        return np.add.reduceat(self.record_lanes(points, heat).density.sum(axis=2), starts, axis=1)

    def keep_first(self, count: int) -> FitProblem:
        """Return the problem of the first samples of each log."""
        logs = [Log(each.name, *(part[:count] for part in each[1:])) for each in self.logs]
        return self._replace(logs=tuple(logs), whole=join_logs(logs))

    def log_prior(self, points: Floats) -> Floats:
        """Return the log of the normal priors at coordinates (lanes)."""
        return np.asarray(-0.5 * (((points - self.start) / self.prior_std) ** 2).sum(axis=1))

    def _compute_plants(self, values: Floats) -> dict[int, Floats]:
        """Return the numbers of plants that are built anew, by slot."""
        if not self.built:
            return {}
        names = [self.free[i].name.removeprefix("plant.") for i in self.built]
        rows, places = np.unique(values[:, self.built], axis=0, return_inverse=True)
        packed = []
        for row in rows.tolist():
            plant = with_numbers(self.scenario.plant, dict(zip(names, row, strict=True)))
            packed.append(tree.pack_tree(plants.system(plant).params))
        found = np.array(packed)[places.ravel()]
        return dict(enumerate(found.T))


def pack_scenario(scenario: Scenario, model: System, zone: Zone) -> FilterNumbers:
    """Return the numbers of a lane, with the plant in continuous time.

    Args:
        scenario: its plant, actuator and disturbance.
        model: the sampled plant.
        zone: its sensor.
    """
    m, p = model.m, model.p
    disturbance: Any = scenario.disturbance
    drive = None
    if scenario.actuator is not None:
        drive = resolve_actuator(scenario.actuator, m)
    return FilterNumbers(
        plant=plants.system(scenario.plant).params,
        right=zone.right,
        left=zone.left,
        slope=zone.slope,
        before=zone.noise_before,
        after=np.hypot(zone.noise, zone.quantum / np.sqrt(12)),
        rms=np.broadcast_to(np.asarray(disturbance.rms, float), (m,)).copy(),
        correlation_time=np.array([disturbance.correlation_time]),
        drive=drive,
        heat_before=np.zeros(p),
        heat_rms=np.zeros(m),
    )


def build_problem(
    scenario: Scenario,
    logs: Sequence[Log],
    free: Sequence[FreeNumber],
    spread: Floats,
    initial: Sequence[FreeNumber],
    threads: int | None,
) -> FitProblem:
    """Return the problem of fitting numbers of a scenario to logs.

    Args:
        scenario: with every table that is needed.
        logs: along which.
        free: numbers that are fitted.
        spread: deviations of x(0) (n) about the scenario's, if no number of it is fitted.
        initial: the numbers of x(0) that are fitted, log by log (empty: none).
        threads: of the lanes.

    Raises:
        InputError: or a subclass, for a scenario or a number that cannot be fitted.
    """
    model = build_model(scenario)
    zone = resolve_zone(scenario)
    like = pack_scenario(scenario, model, zone)
    size = (model.n + model.m) * (model.n + model.m + 3) // 2
    state = np.append(np.zeros(size), np.full(2 * model.p, OPEN))
    state[: model.n] = plants.initial_state(scenario.plant, model)
    slots, built = _find_number_slots(scenario, like, free)
    sampled = []
    if not model.nonlinear:
        AB = np.hstack([like.plant.A, like.plant.B])
        sampled.append(ResampledPlant(0, AB, scenario.simulation.step))
    params = tree.pack_tree(like)
    varies = bool(built) or not model.nonlinear  # a linear plant is sampled by the lanes alone
    computed = range(tree.count_numbers(like.plant) if varies else 0)
    bound = bind_numbers(slots, state, params, sampled, computed=computed)
    kind = choose_kind(zone, free)
    step = build_step(model, kind, like)
    kernel = build_kernel(step, params=range(params.size))
    noise = np.maximum(np.hypot(zone.noise, zone.quantum), 0.02 * zone.noise_before + 1e-12)
    gate = SURE * noise * (kind == "deadzone")
    logs = [each._replace(side=np.sign(each.y) * (np.abs(each.y) > gate)) for each in logs]
    every = (*free, *initial)
    *rows, prior_std, is_log = map(np.array, zip(*(each[1:] for each in every), strict=True))
    is_log = is_log.astype(bool)
    low, high, start = np.log(rows, out=np.array(rows), where=is_log)
    prior_std = prior_std / np.where(is_log, rows[2], 1.0)
    return FitProblem(
        scenario=scenario,
        model=model,
        zone=zone,
        kind=kind,
        free=every,
        built=built,
        slots=tree.leaf_slices(like),
        kernel=kernel,
        bound=bound,
        logs=tuple(logs),
        whole=join_logs(logs),
        spread=spread,
        is_log=is_log,
        low=low,
        high=high,
        start=start,
        prior_std=prior_std,
        threads=threads,
    )


def build_model(scenario: Scenario) -> System:
    """Return the sampled plant of a scenario, without its delay. Raises InputError."""
    simulation = scenario.simulation
    plant = plants.system(scenario.plant)
    return sample_plant(plant, simulation.step, simulation.substeps)


def resolve_zone(scenario: Scenario) -> Zone:
    """Return the sensor of a scenario. Raises InputError if its likelihood is not known."""
    system = plants.system(scenario.plant)
    pace = plant_pace(system.linear)
    zone = resolve_sensor(scenario.sensor, system, scenario.simulation.step, pace)
    if zone.kind not in KINDS or zone.moves:
        raise InputError(
            "sensor.kind: a play has no likelihood here, a dead zone or a jump has. Use "
            "`undeadzone identify` for its gap"
        )
    for name, there in (("range", zone.limits is not None), ("drift", np.any(zone.drift))):
        if there:
            raise InputError(f"sensor.{name}: cannot be fitted with. Leave it out")
    drive = scenario.actuator
    if drive is not None and (drive.kind == "play" or drive.rate is not None):
        raise InputError("actuator: a play or a limited rate cannot be fitted with. Leave it out")
    return zone


def choose_kind(zone: Zone, free: Sequence[FreeNumber]) -> str:
    """Return the kind of the characteristic: "plain" if it has no zone, and none is fitted."""
    zoned = zone.kind != "gears" and np.any([zone.right, zone.left])
    fitted = {stem(each.name) for each in free} & set(WIDTHS[:2])
    return zone.kind if zoned or fitted else "plain"


def _find_number_slots(
    scenario: Scenario, like: FilterNumbers, free: Sequence[FreeNumber]
) -> tuple[list[tuple[tuple[int, float], ...]], tuple[int, ...]]:
    """Return the slots of each number, and the places of those for which the plant is built anew.

    They are found by building the scenario with another value. Raises InputError.
    """
    before = tree.pack_tree(like)
    size = tree.count_numbers(like.plant)
    slots: list[tuple[tuple[int, float], ...]] = []
    built = []
    for i, number in enumerate(free):
        other = number.low + 0.618 * (number.high - number.low)
        changed = with_value(scenario, number.name, other)
        model = build_model(changed)
        packed = tree.pack_tree(pack_scenario(changed, model, resolve_zone(changed)))
        if packed.size != before.size:
            raise InputError(f"free: {number.name} cannot be fitted: the plant changes its form")
        moved = np.flatnonzero(packed != before)
        is_direct = moved.size and (packed[moved] == other).all()
        if not is_direct and (not moved.size or moved.max() >= size):
            raise InputError(
                f"free: {number.name} cannot be fitted here: no reading depends on it alone"
            )
        slots.append(tuple((slot, 1.0) for slot in moved.tolist()) if is_direct else ())
        built += [] if is_direct else [i]
    return slots, tuple(built)
