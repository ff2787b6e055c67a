"""The catalogue of compensators of an actuator's dead zone: one file each.

To add one, write its file and name its options class here.
"""

from undeadzone.compensators.adaptive_inverse import AdaptiveZoneInverse
from undeadzone.compensators.no_inverse import NoInverse
from undeadzone.compensators.smooth_inverse import SmoothZoneInverse
from undeadzone.compensators.zone_inverse import ZoneInverse

CompensatorOptions = NoInverse | ZoneInverse | SmoothZoneInverse | AdaptiveZoneInverse

__all__ = [
    "AdaptiveZoneInverse",
    "CompensatorOptions",
    "NoInverse",
    "SmoothZoneInverse",
    "ZoneInverse",
]
