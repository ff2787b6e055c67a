"""What can be wrong with an input, as exceptions: each message says which key, what was found, what to do."""


class UndeadzoneError(Exception):
    """Base of every error that undeadzone raises on purpose."""


class InputError(UndeadzoneError, ValueError):
    """An input that cannot be used: wrong key, type, number or combination."""


class ShapeError(InputError):
    """A matrix or vector whose shape does not fit the others."""


class StructureError(InputError):
    """A plant or gain for which the task has no solution: unobservable, uncontrollable, not stabilised."""


class TrackingError(InputError):
    """A reference that the plant cannot follow."""


class StepError(InputError):
    """A step or sample time too coarse for the dynamics."""


class FileError(InputError):
    """A file that cannot be read or written, or whose contents are not what they should be."""


class ProofError(InputError):
    """A stored proof that does not hold for what it is said to prove."""


class ClusterError(InputError):
    """A cluster that cannot be reached or used: no workers, workers with other versions, workers that die."""
