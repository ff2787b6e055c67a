"""The catalogue of observers: one file each. To add one, write its file and name its options class here."""

from undeadzone.observers.censored import Censored
from undeadzone.observers.certified import Certified
from undeadzone.observers.interface import Estimate, Observer, Reading
from undeadzone.observers.kalman import Kalman
from undeadzone.observers.luenberger import Luenberger
from undeadzone.observers.oracle import Oracle
from undeadzone.observers.printed import Printed

ObserverOptions = Certified | Kalman | Censored | Luenberger | Oracle | Printed

__all__ = ["Censored", "Certified", "Estimate", "Kalman", "Luenberger", "Observer", "ObserverOptions", "Oracle", "Printed", "Reading"]
