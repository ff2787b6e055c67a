class RestMap: pass
class FlatPart: pass
def map_at_rest(*a): return None
def map_of_rate(*a): return None
