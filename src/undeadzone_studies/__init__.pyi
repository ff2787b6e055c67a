from .ensemble.result import Ensemble as Ensemble
from .ensemble.run_ensemble import replay_run as replay_run
from .ensemble.run_ensemble import run_ensemble as run_ensemble
from .tuning.result import Tuned as Tuned
from .tuning.tune import Sweep as Sweep
from .tuning.tune import sweep as sweep
from .tuning.tune import tune as tune
