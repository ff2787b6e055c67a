class FrictionLevel: pass
def friction_level(*a): return None
