from .no_inverse import NoInverse as NoInverse
from .play_inverse import PlayInverse as PlayInverse
from .smooth_inverse import SmoothZoneInverse as SmoothZoneInverse
from .zone_inverse import ZoneInverse as ZoneInverse
