"""Scene graph: the objects of a compiled scene with geometry, rooms and walls, and what a start pose shows of them."""
