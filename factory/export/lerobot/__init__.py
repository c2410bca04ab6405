"""LeRobot datasets, version 3.0 and 2.1, written with pyarrow and PyAV; lerobot itself is not needed.

Both versions have the same columns, statistics and videos, made episode by episode in `piece`; they differ in how
`v30` and `v21` lay them out.
"""
