from .exporting import Exported as Exported
from .exporting import export as export
from .proving import prove as prove
