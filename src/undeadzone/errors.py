"""Exceptions for faulty inputs.

Each message contains the key, the value found and the remedy. "Raises InputError or a subclass" in
a docstring means the exceptions of this file.
"""


class UndeadzoneError(Exception):
    """Base of every error that undeadzone raises on purpose.

    Example:
        >>> issubclass(uz.InputError, uz.UndeadzoneError)
        True

    See Also:
        InputError
    """


class InputError(UndeadzoneError, ValueError):
    """An input that cannot be used: wrong key, type, number or combination.

    Example:
        >>> try:
        ...     uz.Step(amplitude=1.0, time=-1.0) and uz.simulate(3)
        ... except uz.InputError as error:
        ...     print(error)
        scenario: expected uz.Scenario(...), found int. A file is read by uz.read("mine.toml")

    See Also:
        UndeadzoneError
    """


class ShapeError(InputError):
    """A matrix or vector whose shape does not fit the others."""


class StructureError(InputError):
    """A plant or gain for which the task has no solution.

    The plant is not observable or not controllable, or the gain does not stabilise it.
    """


class TrackingError(InputError):
    """A reference that the plant cannot follow."""


class StepError(InputError):
    """A step or sample time too coarse for the dynamics."""


class InformationError(InputError):
    """A sound log from which nothing can be learnt: too short, or nothing in it moves."""


class FileError(InputError):
    """A file that cannot be read or written, or whose contents are wrong."""


class ProofError(InputError):
    """A stored proof that does not hold for its model."""


class ClusterError(InputError):
    """A cluster that cannot be used.

    It cannot be reached, has no workers or workers with other versions, or its workers die.
    """


class DamagedPackage(UserWarning):
    """An installed package registers something in a file that cannot be read."""


class Terminated(BaseException):
    """SIGTERM reached a command: like KeyboardInterrupt, no error, and nothing should catch it."""


class Interrupted(Terminated):
    """Ctrl-C reached a command. Unlike KeyboardInterrupt, click prints nothing about it."""
