"""The paper's example as printed and as repaired.

The audit holds its variants, facts, figures 1-8, its claims judged and its equations placed. Each
name is imported when it is first used: `undeadzone --help` lists this command, too.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
